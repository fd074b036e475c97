"""A record per image and predictor, and means over scenes with intervals."""

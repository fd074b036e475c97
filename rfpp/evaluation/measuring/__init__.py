"""Scores per scene and predictor, and their means with confidence intervals."""

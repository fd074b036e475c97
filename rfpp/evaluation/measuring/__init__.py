"""Measuring a network on stored scenes: one record per image and predictor, means with intervals."""

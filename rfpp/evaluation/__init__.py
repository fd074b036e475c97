"""A trained network on stored scenes."""

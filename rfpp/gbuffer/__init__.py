"""Rays: what a camera sees first, its direct light and reflections, cells and what they see of each other."""

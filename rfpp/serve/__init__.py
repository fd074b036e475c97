"""Renders for programs on this machine, over HTTP: what Blender's add-on asks."""

"""Rendering for other programs on this machine over HTTP: server and Blender add-on."""

"""Scenes: objects, materials, cameras, and the triangles that everything else reads."""

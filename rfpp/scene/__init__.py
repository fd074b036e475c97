"""What a scene is: objects, materials, cameras, and the triangles that everything else reads."""

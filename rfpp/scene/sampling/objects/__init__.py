"""Sources of object meshes: procedural solids, a folder of meshes, furniture, Objaverse."""

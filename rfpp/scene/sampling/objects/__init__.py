"""Where object meshes come from: procedural solids, a folder of meshes, furniture, Objaverse."""

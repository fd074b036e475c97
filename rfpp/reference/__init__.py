"""Reference images by Blender Cycles in worker processes; only `cycles` imports bpy."""

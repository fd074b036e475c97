"""Ground truth by Blender Cycles, in worker processes; `cycles` alone imports bpy."""

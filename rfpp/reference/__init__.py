"""Ground truth: path-traced images from Blender Cycles."""

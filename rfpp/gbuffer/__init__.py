"""What a camera sees before any light transport: ray casting with Embree, no Blender."""

"""Random scenes: families that draw objects, materials, backgrounds, lights and cameras."""

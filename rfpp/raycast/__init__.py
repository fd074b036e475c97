"""Ray casting with Embree: first hits, G-buffers, direct light and mirror reflections."""

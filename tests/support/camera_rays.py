"""Rays of a camera as NumPy would make them: the twin of those that `rfpp.raycast.first_hit` casts."""

import math

import numpy as np

from rfpp.scene.camera import pixel_plane


def pixel_rays(
    c2w: np.ndarray, fov_degrees: float, height: int, width: int, points: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """[H, W, 3] origins and unit directions in the world, float32, of each pixel's center or points."""
    plane = pixel_plane(height, width, points).astype(np.float64) * math.tan(math.radians(fov_degrees) / 2)
    in_camera = np.concatenate([plane, np.full((height, width, 1), -1.0)], axis=-1)
    directions = in_camera @ c2w[:3, :3].T.astype(np.float64)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins = np.broadcast_to(c2w[:3, 3], directions.shape)
    return np.ascontiguousarray(origins, dtype=np.float32), directions.astype(np.float32)

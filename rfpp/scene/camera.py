"""Camera poses and pixel positions in Blender's convention: looking along -Z, +Y up, +X right."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.scene.spec import Camera


def camera_to_world(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """Return the pose of a look-at camera, float32: columns are right, up, backward and position."""
    backward = _unit(np.subtract(camera.position, camera.look_at, dtype=np.float64))
    right = _unit(np.cross(camera.up, backward))
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(backward, right), backward, camera.position], axis=1)
    return pose.astype(np.float32)


def pixel_plane(height: int, width: int, points: int = 1) -> Float[np.ndarray, "{height} {width} 2"]:
    """Return (x right, y up) of each pixel center, float32, row 0 on top; the longer image side spans [-1, 1].

    Args:
        height: Rows, in points if `points` is above 1.
        width: Columns, in points if `points` is above 1.
        points: Sample points along each side of a pixel, on a rotated grid: no two share a row or a column, so that
            horizontal and vertical edges are antialiased with as many levels as there are points.
    """
    half, middle = max(height, width) / 2, (points - 1) / 2
    row, column = np.arange(height)[:, None], np.arange(width)
    plane = np.empty((height, width, 2), np.float32)
    plane[..., 0] = (column + (row % points - middle) / points + 0.5 - width / 2) / half
    plane[..., 1] = (height / 2 - row + (column % points - middle) / points - 0.5) / half
    return plane


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

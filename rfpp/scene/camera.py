"""The camera's axis convention, stated once: Blender's, looking along -Z, +Y up, +X right."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from rfpp.scene.spec import Camera


def camera_to_world(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """The pose of a look-at camera, float32: columns are its right, up and backward axes and its position."""
    backward = _unit(np.subtract(camera.position, camera.look_at, dtype=np.float64))
    right = _unit(np.cross(camera.up, backward))
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(backward, right), backward, camera.position], axis=1)
    return pose.astype(np.float32)


def pixel_plane(height: int, width: int, points: int = 1) -> Float[np.ndarray, "{height} {width} 2"]:
    """(x right, y up) of each pixel centre, float32, row 0 on top; the longer image side spans [-1, 1].

    Args:
        height, width: in pixels or, where pixels have several points, in points.
        points: along each side of a pixel. Each of its columns leans to the side, each row upwards, so that no two
            points share one: outlines along rows and columns, of which there are many, pass through as many shades as
            there are points (rotated grid supersampling).
    """
    half, middle = max(height, width) / 2, (points - 1) / 2
    row, column = np.arange(height)[:, None], np.arange(width)
    plane = np.empty((height, width, 2), np.float32)
    plane[..., 0] = (column + (row % points - middle) / points + 0.5 - width / 2) / half
    plane[..., 1] = (height / 2 - row + (column % points - middle) / points - 0.5) / half
    return plane


def pixel_rays(
    c2w: Float[np.ndarray, "4 4"], fov_degrees: float, height: int, width: int, points: int = 1
) -> tuple[Float[np.ndarray, "{height} {width} 3"], Float[np.ndarray, "{height} {width} 3"]]:
    """World-space rays through the pixel centres.

    Args:
        c2w: camera-to-world matrix.
        fov_degrees: full field of view along the longer image side.
        height, width, points: see `pixel_plane`.

    Returns:
        origins and unit directions, float32.
    """
    plane = pixel_plane(height, width, points).astype(np.float64) * math.tan(math.radians(fov_degrees) / 2)
    in_camera = np.concatenate([plane, np.full((height, width, 1), -1.0)], axis=-1)
    directions = _unit(rotated(in_camera, c2w[:3, :3].astype(np.float64)))
    origins = np.broadcast_to(c2w[:3, 3], directions.shape)
    return np.ascontiguousarray(origins, dtype=np.float32), directions.astype(np.float32)


def rotated(vectors: Float[np.ndarray, "*batch 3"], rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Each vector v as rotation · v.

    Not by NumPy's matrix product: its threads go on spinning for a while after it, and take the cores from those that
    cast rays.
    """
    turned: np.ndarray = np.einsum("...j,ij->...i", vectors, rotation)
    return turned


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

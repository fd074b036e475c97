"""What Blender's cameras and viewports see, as the server is asked for it."""

from __future__ import annotations

import math

import numpy as np

Window = tuple[float, float, float, float]


class NoView(Exception):  # noqa: N818
    """One line on why nothing can be shown."""


def rows_of(matrix) -> tuple[tuple[float, ...], ...]:
    """The first three rows of a matrix of Blender's."""
    return tuple(tuple(float(value) for value in row) for row in list(matrix)[:3])


def window_of(projection) -> Window:
    """Left, right, bottom and top of what a perspective projection matrix shows, at distance 1."""
    across, up = projection[0][0], projection[1][1]
    left, right = ((projection[0][2] + side) / across for side in (-1, 1))
    bottom, top = ((projection[1][2] + side) / up for side in (-1, 1))
    return left, right, bottom, top


def camera_window(camera, depsgraph, size: tuple[int, int]) -> Window:
    """Of a camera object, for pictures of (height, width). Raises NoView: it has no perspective."""
    if camera.data.type != "PERSP":
        raise NoView(f"Camera '{camera.name}' is no perspective camera: change its Lens Type to Perspective")
    return window_of(camera.calc_matrix_camera(depsgraph, x=size[1], y=size[0]))


def part_of(window: Window, size: tuple[int, int], box: tuple[int, int, int, int]) -> Window:
    """The window of the pixels from (x, y) on, counted from below, so many wide and high."""
    left, right, bottom, top = window
    pitch = (right - left) / size[1], (top - bottom) / size[0]
    x, y, width, height = box
    return left + x * pitch[0], left + (x + width) * pitch[0], bottom + y * pitch[1], bottom + (y + height) * pitch[1]


def square_pixels(window: Window, size: tuple[int, int]) -> Window:
    """As high as square pixels make it."""
    left, right, bottom, top = window
    half = (right - left) / size[1] * size[0] / 2
    middle = (bottom + top) / 2
    return left, right, middle - half, middle + half


def shrunk(size: tuple[int, int], longer_side: int) -> tuple[int, int]:
    """(height, width) with at most so many pixels along the longer side."""
    factor = min(1.0, longer_side / max(size))
    height, width = (max(1, round(side * factor)) for side in size)
    return height, width


def gltf_camera(window: Window) -> dict:
    """As glTF has it, looking straight."""
    left, right, bottom, top = window
    yfov, aspect = 2 * math.atan((top - bottom) / 2), (right - left) / (top - bottom)
    return {"type": "perspective", "perspective": {"yfov": yfov, "aspectRatio": aspect, "znear": 0.01}}


def is_finite(matrix: np.ndarray) -> bool:
    """Whether an object is somewhere."""
    return bool((np.abs(matrix) < 1e15).all())

"""Windows of Blender's cameras and viewports: left, right, bottom and top at distance 1 in front of the camera."""

from __future__ import annotations

Window = tuple[float, float, float, float]


class NoView(Exception):  # noqa: N818
    """Reason for a view that cannot be rendered, one line."""


def rows_of(matrix) -> tuple[tuple[float, ...], ...]:
    """Return the first three rows of a matrix of Blender."""
    return tuple(tuple(float(value) for value in row) for row in list(matrix)[:3])


def window_of(projection) -> Window:
    """Return the window of a perspective projection matrix."""
    across, up = projection[0][0], projection[1][1]
    left, right = ((projection[0][2] + side) / across for side in (-1, 1))
    bottom, top = ((projection[1][2] + side) / up for side in (-1, 1))
    return left, right, bottom, top


def camera_window(camera, depsgraph, size: tuple[int, int]) -> Window:
    """Return the window of a camera for pictures of (height, width). Raises NoView if it has no perspective."""
    if camera.data.type != "PERSP":
        raise NoView(f"Camera '{camera.name}' has no perspective: change its Lens Type to Perspective")
    return window_of(camera.calc_matrix_camera(depsgraph, x=size[1], y=size[0]))


def part_of(window: Window, size: tuple[int, int], box: tuple[int, int, int, int]) -> Window:
    """Return the window of a box of pixels: x, y from the bottom left, width and height."""
    left, right, bottom, top = window
    pitch = (right - left) / size[1], (top - bottom) / size[0]
    x, y, width, height = box
    return left + x * pitch[0], left + (x + width) * pitch[0], bottom + y * pitch[1], bottom + (y + height) * pitch[1]


def square_pixels(window: Window, size: tuple[int, int]) -> Window:
    """Return a window of the same width whose pixels are square."""
    left, right, bottom, top = window
    half = (right - left) / size[1] * size[0] / 2
    middle = (bottom + top) / 2
    return left, right, middle - half, middle + half


def shrunk(size: tuple[int, int], longer_side: int) -> tuple[int, int]:
    """Return (height, width) limited to a longer side."""
    factor = min(1.0, longer_side / max(size))
    height, width = (max(1, round(side * factor)) for side in size)
    return height, width

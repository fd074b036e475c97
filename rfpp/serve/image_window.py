"""Any window into a scene as part of a centered image that consists of whole patches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError

#: Largest relative difference between a pixel's width and height.
_SQUARE = 0.01
#: Largest image, in multiples of the window's pixels, that is rendered for the sake of a lens shift.
_MAX_OVERHEAD = 8.0


@dataclass(frozen=True)
class ImageWindow:
    """A window in a centered image; sizes are (height, width) in pixels."""

    image_size: tuple[int, int]
    fov: float  # full angle of the image in degrees along its longer side
    corner: tuple[int, int]  # (row, column) of the window's upper left pixel
    size: tuple[int, int]

    @classmethod
    def around(cls, edges: tuple[float, float, float, float], size: tuple[int, int], patch: int) -> ImageWindow:
        """Return a window in the smallest image that holds it; a window of odd size may move by half a pixel.

        Args:
            edges: Left, right, bottom and top of the window in the plane at distance 1 in front of the camera.
            size: (height, width) of the window in pixels.
            patch: Divisor of both sides of the image.

        Raises:
            SceneError: If the window is empty, far off center, or has pixels that are not square.
        """
        left, right, bottom, top = edges
        height, width = size
        if not (left < right and bottom < top):
            raise SceneError(f"window {edges}: is empty: give left < right and bottom < top")
        pitch = (right - left) / width
        if not math.isclose(pitch, (top - bottom) / height, rel_tol=_SQUARE):
            raise SceneError(f"window {edges} of {width} x {height}: pixels are not square: change either")
        rows, columns = (
            patch * math.ceil(round(2 * max(map(abs, pair)) / pitch / patch, 3))
            for pair in ((bottom, top), (left, right))
        )
        if rows * columns > _MAX_OVERHEAD * (height + patch) * (width + patch):
            raise SceneError(f"window {edges}: is too far off center: shift the lens less")
        corner = (rows / 2 - top / pitch, columns / 2 + left / pitch)
        row, column = (
            min(max(math.floor(start + 0.5), 0), whole - part)
            for start, whole, part in zip(corner, (rows, columns), size, strict=True)
        )
        fov = 2 * math.degrees(math.atan(max(rows, columns) * pitch / 2))
        return cls((rows, columns), fov, (row, column), size)

    def crop(self, image: Float[np.ndarray, "h w *channels"]) -> Float[np.ndarray, "hh ww *channels"]:
        """Return the window's part of the image."""
        (row, column), (height, width) = self.corner, self.size
        return image[row : row + height, column : column + width]

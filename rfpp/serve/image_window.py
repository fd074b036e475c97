"""Any window into a scene as part of an image that a network renders: centred, of whole patches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError

#: Pixels wider than high by more than this share would come out distorted.
_SQUARE = 0.01
#: An image of this many times the window's pixels is rendered at most, for the sake of a lens shift.
_MOST_AROUND = 8.0


@dataclass(frozen=True)
class Frame:
    """A centred image, and the window in it.

    Attributes:
        size: (height, width) in pixels.
        fov: full angle in degrees along the longer side.
        corner: (row, column) of the window's upper left pixel.
        window: (height, width) of the window.
    """

    size: tuple[int, int]
    fov: float
    corner: tuple[int, int]
    window: tuple[int, int]

    @classmethod
    def around(cls, edges: tuple[float, float, float, float], window: tuple[int, int], patch: int) -> Frame:
        """The smallest image that holds a window.

        Where a window of an odd number of pixels is centred, it is moved by half a pixel.

        Args:
            edges: left, right, bottom and top of the window where it cuts the plane at distance 1 before the camera.
            window: (height, width) in pixels.
            patch: both sides of the image are multiples of it.

        Raises:
            SceneError: edges that enclose nothing, pixels that are not square, or a window far off the middle.
        """
        left, right, bottom, top = edges
        height, width = window
        if not (left < right and bottom < top):
            raise SceneError(f"window {edges}: encloses nothing: give left < right and bottom < top")
        pitch = (right - left) / width
        if not math.isclose(pitch, (top - bottom) / height, rel_tol=_SQUARE):
            raise SceneError(f"window {edges} of {width} x {height}: its pixels are not square: make them so")
        rows, columns = (
            patch * math.ceil(round(2 * max(map(abs, pair)) / pitch / patch, 3))
            for pair in ((bottom, top), (left, right))
        )
        if rows * columns > _MOST_AROUND * (height + patch) * (width + patch):
            raise SceneError(f"window {edges}: is too far off the middle: shift the lens less")
        corner = (rows / 2 - top / pitch, columns / 2 + left / pitch)
        row, column = (
            min(max(math.floor(start + 0.5), 0), whole - part)
            for start, whole, part in zip(corner, (rows, columns), window, strict=True)
        )
        fov = 2 * math.degrees(math.atan(max(rows, columns) * pitch / 2))
        return cls((rows, columns), fov, (row, column), window)

    def cut(self, image: Float[np.ndarray, "h w *channels"]) -> Float[np.ndarray, "hh ww *channels"]:
        """The window out of the image."""
        (row, column), (height, width) = self.corner, self.window
        return image[row : row + height, column : column + width]

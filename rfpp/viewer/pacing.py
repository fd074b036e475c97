"""Choose the interactive resolution from recent frame times."""

from __future__ import annotations

import math

#: Pixels along the longer side of the smallest image.
_SMALLEST = 64
#: Weight of the newest image in the estimate.
_NEW = 0.5


class Pacing:
    """Chooses the resolution while the camera moves from what images took before.

    Args:
        patch: both sides of an image are multiples of it.
        seconds: an image in motion may take.
    """

    def __init__(self, patch: int, seconds: float | int):
        self.patch, self.seconds = patch, seconds
        self._per_pixel: float | None = None

    def size(self, longer_side: int, aspect: float) -> tuple[int, int]:
        """(height, width) at rest.

        Args:
            longer_side: pixels.
            aspect: width / height of the window.
        """
        sides = (longer_side / aspect, longer_side) if aspect > 1 else (longer_side, longer_side * aspect)
        height, width = (max(self.patch, self.patch * round(side / self.patch)) for side in sides)
        return height, width

    def moving_size(self, longer_side: int, aspect: float) -> tuple[int, int]:
        """(height, width) that should take no longer than an image in motion may."""
        height, width = self.size(longer_side, aspect)
        if self._per_pixel is None:
            return self.size(min(_SMALLEST, longer_side), aspect)
        affordable = math.sqrt(self.seconds / (self._per_pixel * height * width))
        return self.size(max(min(_SMALLEST, longer_side), int(longer_side * min(1.0, affordable))), aspect)

    def took(self, size: tuple[int, int], seconds: float) -> None:
        """An image was made."""
        per_pixel = seconds / (size[0] * size[1])
        self._per_pixel = per_pixel if self._per_pixel is None else _NEW * per_pixel + (1 - _NEW) * self._per_pixel

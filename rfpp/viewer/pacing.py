"""Choose the resolution of a moving view from recent frame times."""

from __future__ import annotations

import math

#: Pixels along the longer side of the smallest image.
_SMALLEST = 64


class Pacing:
    """Resolutions in multiples of `patch`; images in motion should take `seconds`."""

    def __init__(self, patch: int, seconds: float | int):
        self.patch, self.seconds = patch, seconds
        self._per_pixel: float | None = None

    def size(self, longer_side: int, aspect: float) -> tuple[int, int]:
        """Return (height, width) at rest for a window whose width / height is `aspect`."""
        sides = (longer_side / aspect, longer_side) if aspect > 1 else (longer_side, longer_side * aspect)
        height, width = (max(self.patch, self.patch * round(side / self.patch)) for side in sides)
        return height, width

    def moving_size(self, longer_side: int, aspect: float) -> tuple[int, int]:
        """Return (height, width) that should meet the target time."""
        height, width = self.size(longer_side, aspect)
        smallest = min(_SMALLEST, longer_side)
        if self._per_pixel is None:
            return self.size(smallest, aspect)
        share = math.sqrt(self.seconds / (self._per_pixel * height * width))
        return self.size(max(smallest, int(longer_side * min(1.0, share))), aspect)

    def record(self, size: tuple[int, int], seconds: float) -> None:
        """Record the time of an image in motion."""
        newest = seconds / (size[0] * size[1])
        self._per_pixel = newest if self._per_pixel is None else (newest + self._per_pixel) / 2

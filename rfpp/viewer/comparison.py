"""Compare a picture with its path-traced reference: wipe or side by side."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import UInt8
from PIL import Image

Picture = UInt8[np.ndarray, "h w 3"]

_LINE = (255, 255, 255)


class Comparison(ABC):
    """How two pictures of one size share a window."""

    @abstractmethod
    def __call__(self, picture: Picture, reference: Picture, share: float) -> Picture:
        """`share` of the window's width belongs to the picture."""


class Wipe(Comparison):
    """The picture left of a line, the reference right of it."""

    def __call__(self, picture: Picture, reference: Picture, share: float) -> Picture:
        edge = round(share * picture.shape[1])
        joined = np.concatenate([picture[:, :edge], reference[:, edge:]], axis=1)
        if 0 < edge < picture.shape[1]:
            joined[:, edge] = _LINE
        return joined


class SideBySide(Comparison):
    """Both whole, at half the size."""

    def __call__(self, picture: Picture, reference: Picture, share: float) -> Picture:
        height, width = picture.shape[:2]
        joined = np.zeros_like(picture)
        top = height // 4
        for column, whole in ((0, picture), (width - width // 2, reference)):
            half = np.asarray(Image.fromarray(whole).resize((width // 2, height // 2), Image.Resampling.BOX))
            joined[top : top + height // 2, column : column + width // 2] = half
        return joined


def enlarged(picture: Picture, size: tuple[int, int]) -> Picture:
    """To (height, width), its pixels visible."""
    height, width = size
    if picture.shape[:2] == (height, width):
        return picture
    return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST))


#: By the names that people choose from.
COMPARISONS: dict[str, Comparison] = {"wipe": Wipe(), "side by side": SideBySide()}

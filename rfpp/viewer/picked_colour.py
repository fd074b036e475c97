"""Convert between 8-bit sRGB of colour pickers and linear colours."""

from __future__ import annotations

import torch

from rfpp.imaging.radiance import srgb, to_8bit
from rfpp.scene.spec import Vector


def to_picker(linear: Vector) -> tuple[int, int, int]:
    """The nearest of the picker's colours."""
    return tuple(to_8bit(srgb(torch.tensor(linear))).tolist())


def from_picker(picked: tuple[int, int, int]) -> Vector:
    """Linear, by the inverse of sRGB's transfer curve (IEC 61966-2-1)."""
    return tuple(v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (c / 255 for c in picked))

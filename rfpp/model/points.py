"""Between pixels and the points within them at which G-buffers are sampled and surfaces shaded."""

from __future__ import annotations

from functools import reduce

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def means(points: Float[Tensor, "n c h w"], number: int) -> Float[Tensor, "n c height width"]:
    """From `number` points along each side of a pixel to pixels."""
    if number == 1:
        return points
    # row by row, then column by column: a tenth of what pooling takes on a CPU
    rows: Tensor = reduce(torch.add, points.unflatten(-2, (-1, number)).unbind(-2))
    sums: Tensor = reduce(torch.add, rows.unflatten(-1, (-1, number)).unbind(-1))
    return sums / number**2


def repeated(pixels: Float[Tensor, "n c height width"], number: int) -> Float[Tensor, "n c h w"]:
    """A pixel's value at each of its points."""
    return pixels if number == 1 else F.interpolate(pixels, scale_factor=number, mode="nearest")

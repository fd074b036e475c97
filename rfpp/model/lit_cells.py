"""Cells of scenes with what a network makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.packed_cells import PackedCells


@dataclass(frozen=True)
class LitCells:
    """The cells of B scenes, packed, as light moves between them.

    Attributes:
        cells: what they are.
        features: [C, D] what the scene tokens say of each: of geometry and materials, never of light.
        start: [C, 3] radiance ⁽⁰⁾L that leaves each before any of it has moved on.
        light: [C, 3] radiance ⁽ᵏ⁾L that leaves each.
    """

    cells: PackedCells
    features: Float[Tensor, "c width"]
    start: Float[Tensor, "c 3"]
    light: Float[Tensor, "c 3"]

    def rows(self, seen: Float[Tensor, "n rays h w"]) -> Int[Tensor, "n rays h w"]:
        """Cells that N views see, equally many of each scene, from numbers within the scene to rows; C for none."""
        starts = self.cells.scenes.offsets[:-1].long()
        first = starts.repeat_interleave(len(seen) // len(starts))[:, None, None, None]
        return torch.where(seen < 0, len(self.cells), seen.long() + first)

"""Cells of scenes with what a network makes of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.packed_cells import PackedCells


@dataclass(frozen=True)
class Reflectance:
    """What cells send on of the light that arrives.

    Attributes:
        diffuse: [C, 3] to all sides.
        specular: [C, 3] back along rays, of what their lobe sees.
    """

    diffuse: Float[Tensor, "c 3"]
    specular: Float[Tensor, "c 3"]

    @property
    def dull(self) -> Float[Tensor, "c 3"]:
        """To all sides, where nobody asks for directions."""
        return self.diffuse + self.specular

    def bounded(self, highest: float) -> Reflectance:
        """With no sum of both above `highest`."""
        within = highest / self.dull.clamp_min(highest)
        return Reflectance(self.diffuse * within, self.specular * within)


@dataclass(frozen=True)
class LitCells:
    """The cells of B scenes, packed, as light moves between them. Light that arrives is irradiance / π.

    Attributes:
        cells: what they are.
        features: [C, D] what the scene tokens say of each: of geometry and materials, never of light.
        reflectance: of each.
        first: [C, 3] light ⁽⁰⁾I that arrives straight from the emitters.
        arriving: [C, 3] ⁽ᵏ⁾I, after at most k bounces.
        before: [C, 3] ⁽ᵏ⁻¹⁾I.
    """

    cells: PackedCells
    features: Float[Tensor, "c width"]
    reflectance: Reflectance
    first: Float[Tensor, "c 3"]
    arriving: Float[Tensor, "c 3"]
    before: Float[Tensor, "c 3"]

    def rows(self, seen: Float[Tensor, "n rays h w"]) -> Int[Tensor, "n rays h w"]:
        """Cells that N views see, equally many of each scene, from numbers within the scene to rows; C for none."""
        starts = self.cells.scenes.offsets[:-1].long()
        first = starts.repeat_interleave(len(seen) // len(starts))[:, None, None, None]
        return torch.where(seen < 0, len(self.cells), seen.long() + first)

    def beyond_first(self) -> LitCells:
        """Without what leaves to all sides as the emitters light it."""
        return replace(self, arriving=self.arriving - self.first)

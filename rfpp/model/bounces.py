"""A bounce of light among cells: from what arrives at them to what then arrives."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.model.couplings import Couplings, RayCouplings, of_rays
from rfpp.model.lit_cells import Reflectance
from rfpp.packed_cells import PackedCells


class DullBounce:
    """A ρ I: all that cells send on leaves them to all sides.

    Args:
        couplings: A.
        reflectance: ρ.
    """

    def __init__(self, cells: PackedCells, couplings: Couplings, reflectance: Reflectance):
        self.couplings, self.reflectance = couplings, reflectance

    def __call__(self, arriving: Float[Tensor, "c 3"], before: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """⁽ᵏ⁺¹⁾I less what arrives straight from the emitters, of ⁽ᵏ⁾I and ⁽ᵏ⁻¹⁾I."""
        return self.couplings.arriving(self.reflectance.dull * arriving)


class GlossyBounce(DullBounce):
    """A ρ_d I, and what glossy lobes send back along the cells' rays: highlights, and of light two bounces ago.

    With row sums of A of at most 1 and ρ_d + ρ_s below 1, energy never grows.
    """

    def __init__(self, cells: PackedCells, couplings: RayCouplings, reflectance: Reflectance):
        super().__init__(cells, couplings, reflectance)
        self.onward, self.highlights = cells.rows(cells.onward), cells.highlights
        self.weight = of_rays(reflectance.specular, couplings.ends) * couplings.share[..., None]

    def __call__(self, arriving: Float[Tensor, "c 3"], before: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """See DullBounce."""
        straight = self.couplings.arriving(self.reflectance.diffuse * arriving)
        mirrored = (self.weight * of_rays(self.reflectance.dull * before, self.onward)).sum(1)
        return straight + self.highlights + mirrored


def light_after(first: Float[Tensor, "c 3"], bounce: DullBounce, count: int) -> tuple[Float[Tensor, "c 3"], ...]:
    """⁽⁰⁾I = `first`, ⁽¹⁾I … ⁽ᶜᵒᵘⁿᵗ⁾I: what arrives after at most so many bounces."""
    before, states = torch.zeros_like(first), [first]
    for _ in range(count):
        states.append(first + bounce(states[-1], before))
        before = states[-2]
    return tuple(states)

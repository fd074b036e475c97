"""A bounce of light among cells: from what arrives at them to what then arrives."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.model.lit_cells import Reflectance
from rfpp.packed_cells import PackedCells


class DullBounce:
    """A ρ I: all that cells send on leaves them to all sides.

    Args:
        couplings: A of every scene, padded.
        reflectance: ρ.
        seen: form factors, of which A is made.
    """

    def __init__(
        self,
        cells: PackedCells,
        couplings: Float[Tensor, "b longest longest"],
        reflectance: Reflectance,
        seen: Float[Tensor, "b longest longest"],
    ):
        self.cells, self.couplings, self.reflectance = cells, couplings, reflectance

    def __call__(self, arriving: Float[Tensor, "c 3"], before: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """⁽ᵏ⁺¹⁾I less what arrives straight from the emitters, of ⁽ᵏ⁾I and ⁽ᵏ⁻¹⁾I."""
        return self._seen(self.reflectance.dull * arriving)

    def _seen(self, leaving: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """A L."""
        return self.cells.packed(self.couplings @ self.cells.padded(leaving))


class GlossyBounce(DullBounce):
    """A ρ_d I, and what glossy lobes send back along the cells' rays: highlights, and of light two bounces ago.

    With row sums of A of at most 1 and ρ_d + ρ_s below 1, energy never grows.
    """

    def __init__(
        self,
        cells: PackedCells,
        couplings: Float[Tensor, "b longest longest"],
        reflectance: Reflectance,
        seen: Float[Tensor, "b longest longest"],
    ):
        super().__init__(cells, couplings, reflectance, seen)
        starts = cells.scenes.offsets[:-1].long()[cells.scenes.index][:, None]
        ends, self.onward = (torch.where(x < 0, len(cells), x + starts) for x in (cells.hits, cells.onward))
        # each ray stands for its share of what its two cells exchange
        share = (couplings / seen.clamp_min(1e-12)).gather(2, cells.padded(cells.hits).clamp_min(0))
        self.weight = of_rays(reflectance.specular, ends) * (cells.packed(share) / ends.shape[1])[..., None]
        self.highlights = cells.highlights

    def __call__(self, arriving: Float[Tensor, "c 3"], before: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """See DullBounce."""
        straight = self._seen(self.reflectance.diffuse * arriving)
        mirrored = (self.weight * of_rays(self.reflectance.dull * before, self.onward)).sum(1)
        return straight + self.highlights + mirrored


def light_after(first: Float[Tensor, "c 3"], bounce: DullBounce, count: int) -> tuple[Float[Tensor, "c 3"], ...]:
    """⁽⁰⁾I = `first`, ⁽¹⁾I … ⁽ᶜᵒᵘⁿᵗ⁾I: what arrives after at most so many bounces."""
    before, states = torch.zeros_like(first), [first]
    for _ in range(count):
        states.append(first + bounce(states[-1], before))
        before = states[-2]
    return tuple(states)


def of_rays(of_cells: Float[Tensor, "c n"], rows: Int[Tensor, " *rays"]) -> Float[Tensor, " *rays n"]:
    """What each ray brings of the cell that it meets; zeros where it meets none (row C)."""
    with_nothing = torch.cat([of_cells, of_cells.new_zeros(1, of_cells.shape[1])])
    return F.embedding(rows, with_nothing)  # as indexing, with a gradient that is five times as fast on a CPU

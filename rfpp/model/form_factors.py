"""How much of what arrives at a cell comes from each other cell: the part of light transport that is geometry.

A form factor F_ij is the share of the directions above cell i, weighted by their cosine, in which cell j is seen; what
is missing to 1 escapes. Two ways to have it, of which the second needs no rays and knows no shadows.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.model.bounces import DullBounce, GlossyBounce
from rfpp.model.couplings import Corrections, DenseCouplings, RayCouplings
from rfpp.model.lit_cells import Reflectance
from rfpp.packed_cells import PackedCells

#: Of what arrives at a cell at least so much comes from nowhere, where that has to be guessed.
_LEAST_ESCAPING = 0.02


class CastFormFactors:
    """Of the rays stored with each cell (Embree): exact but for their number."""

    def __call__(self, cells: PackedCells, corrections: Corrections | None = None) -> RayCouplings:
        """A: form factors, each times its correction, if there are any, and again 1 together with what escapes."""
        meets = (cells.hits >= 0).to(cells.area)
        weight, sink = meets / cells.hits.shape[1], 1 - meets.mean(-1)
        if corrections is not None:
            weight = weight * corrections.of_rays(cells.rows(cells.hits))
            sink = sink * corrections.of_escape()
        return RayCouplings(cells, weight, sink)

    def bounce(
        self, cells: PackedCells, reflectance: Reflectance, corrections: Corrections | None = None
    ) -> GlossyBounce:
        """What these couplings do to light: rays know where glossy lobes send it."""
        return GlossyBounce(cells, self(cells, corrections), reflectance)


class UnoccludedFormFactors:
    """cosᵢ cosⱼ Aⱼ / (π d² + Aⱼ) between centres and mean normals, as if nothing stood in between.

    For surfaces far apart the form factor of a differential area to a small one; for near ones bounded by 1.
    """

    def __call__(self, cells: PackedCells, corrections: Corrections | None = None) -> DenseCouplings:
        """As `CastFormFactors`; rows that would exceed 1 are made to fit when they are normalised."""
        seen = self._seen(cells)
        sink = (1 - seen.sum(-1)).clamp_min(_LEAST_ESCAPING)
        if corrections is not None:
            seen, sink = seen * corrections.of_pairs(cells), sink * cells.padded(corrections.of_escape())
        return DenseCouplings(cells, seen, sink)

    def bounce(
        self, cells: PackedCells, reflectance: Reflectance, corrections: Corrections | None = None
    ) -> DullBounce:
        """What these couplings do to light."""
        return DullBounce(cells, self(cells, corrections), reflectance)

    def _seen(self, cells: PackedCells) -> Float[Tensor, "b longest longest"]:
        centre, normal, area = (cells.padded(x) for x in (cells.centre, cells.normal, cells.area[:, None]))
        way = centre[:, None] - centre[:, :, None]  # [B, i, j, 3] from i to j
        distance2 = way.square().sum(-1)
        leaving = torch.einsum("bijx,bix->bij", way, normal).clamp_min(0)
        arriving = -torch.einsum("bijx,bjx->bij", way, normal).clamp_max(0)
        area = area.transpose(1, 2)
        facing = (torch.pi * distance2 + area).clamp_min(1e-12)  # 0 between rows of padding
        return leaving * arriving / distance2.clamp_min(1e-12) * area / facing

"""How much of what arrives at a cell comes from each other cell: the part of light transport that is geometry.

A form factor F_ij is the share of the directions above cell i, weighted by their cosine, in which cell j is seen; what
is missing to 1 escapes. Two ways to have it, of which the second needs no rays and knows no shadows.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.model.bounces import DullBounce, GlossyBounce
from rfpp.packed_cells import PackedCells

#: Of what arrives at a cell at least so much comes from nowhere, where that has to be guessed.
_LEAST_ESCAPING = 0.02
#: A share below which it makes no difference how wrong A is: of 64 rays, one in 64 cells.
_LEAST_SHARE = 1 / 4096


class CastFormFactors:
    """Of the rays stored with each cell (Embree): exact but for their number."""

    #: Rays know where glossy lobes send light.
    bounce = GlossyBounce

    def __call__(self, cells: PackedCells) -> tuple[Float[Tensor, "b c c"], Float[Tensor, "b c"]]:
        """F_ij of every pair of cells of a scene, padded, and what escapes; together 1 in each row."""
        hits = cells.padded(cells.hits + 1)  # [B, C, R]; padding and misses go to column 0
        rays = hits.shape[-1]
        counted = cells.area.new_zeros(*hits.shape[:2], hits.shape[1] + 1)
        counted.scatter_add_(2, hits, counted.new_ones(1).expand(hits.shape))
        shares = counted / rays
        return shares[..., 1:], shares[..., 0]


class UnoccludedFormFactors:
    """cosᵢ cosⱼ Aⱼ / (π d² + Aⱼ) between centres and mean normals, as if nothing stood in between.

    For surfaces far apart the form factor of a differential area to a small one; for near ones bounded by 1.
    """

    bounce = DullBounce

    def __call__(self, cells: PackedCells) -> tuple[Float[Tensor, "b c c"], Float[Tensor, "b c"]]:
        """As `CastFormFactors`; rows that would exceed 1 are made to fit when they are normalised."""
        centre, normal, area = (cells.padded(x) for x in (cells.centre, cells.normal, cells.area[:, None]))
        way = centre[:, None] - centre[:, :, None]  # [B, i, j, 3] from i to j
        distance2 = way.square().sum(-1)
        leaving = torch.einsum("bijx,bix->bij", way, normal).clamp_min(0)
        arriving = -torch.einsum("bijx,bjx->bij", way, normal).clamp_max(0)
        area = area.transpose(1, 2)
        facing = (torch.pi * distance2 + area).clamp_min(1e-12)  # 0 between rows of padding
        seen = leaving * arriving / distance2.clamp_min(1e-12) * area / facing
        return seen, (1 - seen.sum(-1)).clamp_min(_LEAST_ESCAPING)


def divergence(couplings: Float[Tensor, "b c c"], cells: PackedCells) -> Float[Tensor, ""]:
    """Kullback-Leibler divergence of A from cast form factors, in nats, a mean over cells: how far from what rays see.

    Args:
        couplings: A of every scene, padded; what its rows lack to 1 escapes.
    """
    seen, escaping = CastFormFactors()(cells)
    target = torch.cat([seen, escaping[..., None]], dim=-1)
    guess = torch.cat([couplings, 1 - couplings.sum(-1, keepdim=True)], dim=-1).clamp_min(_LEAST_SHARE)
    return cells.packed((torch.xlogy(target, target) - target * guess.log()).sum(-1)).mean()

"""A of linear light transport: from the light that leaves cells to the light that arrives at them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.packed_cells import PackedCells

#: A share below which it makes no difference how wrong A is: of 64 rays, one in 64 cells.
_LEAST_SHARE = 1 / 4096


@runtime_checkable
class Couplings(Protocol):
    """A matrix between the cells of each scene, with row sums of at most 1: what they lack escapes."""

    def arriving(self, leaving: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """A L."""

    def divergence(self) -> Float[Tensor, ""]:
        """Kullback-Leibler divergence of A from what the cells' rays see, in nats, a mean over cells."""


class RayCouplings:
    """A by the rays of each cell: every one brings its share of what leaves the cell in which it ends.

    Not a number for each pair of cells, of which nearly all are zero: time and memory grow with the cells, not with
    their square.

    Args:
        weight: [C, R] of rays; 0 for one that meets nothing.
        sink: [C] weight of what escapes.
    """

    def __init__(self, cells: PackedCells, weight: Float[Tensor, "c rays"], sink: Float[Tensor, " c"]):
        self.cells, self.ends = cells, cells.rows(cells.hits)
        whole = (weight.sum(-1) + sink).clamp_min(1e-12)
        #: [C, R] of what leaves the cell where each ray ends; [C] of what escapes.
        self.share, self.escaping = weight / whole[:, None], sink / whole

    def arriving(self, leaving: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """See `Couplings`."""
        return torch.einsum("cr,crk->ck", self.share, of_rays(leaving, self.ends))

    def divergence(self) -> Float[Tensor, ""]:
        """See `Couplings`: rays with the same end are alike, so each is compared with its own share."""
        meets, rays = (self.cells.hits >= 0).to(self.share), self.cells.hits.shape[1]
        by_cells = (meets * -(rays * self.share.clamp_min(_LEAST_SHARE)).log()).sum(-1) / rays
        escaping = 1 - meets.mean(-1)
        missed = torch.xlogy(escaping, escaping) - escaping * self.escaping.clamp_min(_LEAST_SHARE).log()
        return (by_cells + missed).mean()


class DenseCouplings:
    """A as a number for each pair of cells.

    Args:
        weight: [B, longest, longest] of pairs of cells of a scene, padded.
        sink: [B, longest] weight of what escapes.
    """

    def __init__(
        self, cells: PackedCells, weight: Float[Tensor, "b longest longest"], sink: Float[Tensor, "b longest"]
    ):
        self.cells = cells
        #: [B, longest, longest] of what leaves each cell.
        self.share = weight / (weight.sum(-1) + sink).clamp_min(1e-12)[..., None]

    def arriving(self, leaving: Float[Tensor, "c 3"]) -> Float[Tensor, "c 3"]:
        """See `Couplings`."""
        return self.cells.packed(self.share @ self.cells.padded(leaving))

    def divergence(self) -> Float[Tensor, ""]:
        """See `Couplings`."""
        target = _seen(self.cells)
        escaping = 1 - self.share.sum(-1, keepdim=True)
        guess = torch.cat([escaping, self.share], dim=-1).clamp_min(_LEAST_SHARE)
        return self.cells.packed((torch.xlogy(target, target) - target * guess.log()).sum(-1)).mean()


@dataclass(frozen=True)
class Corrections:
    """Factors e^(γ tanh(score)), learned from pairs of cells.

    Attributes:
        query, key: [C, rank] whose products are the scores of pairs.
        escape: [C] the scores of what escapes.
        bound: γ.
    """

    query: Float[Tensor, "c rank"]
    key: Float[Tensor, "c rank"]
    escape: Float[Tensor, " c"]
    bound: float

    def of_rays(self, ends: Int[Tensor, "c rays"]) -> Float[Tensor, "c rays"]:
        """Of each cell and that in which its rays end (row C: none)."""
        return self._factor(torch.einsum("cq,crq->cr", self.query, of_rays(self.key, ends)) / self._scale)

    def of_pairs(self, cells: PackedCells) -> Float[Tensor, "b longest longest"]:
        """Of every two cells of a scene, padded."""
        return self._factor(cells.padded(self.query) @ cells.padded(self.key).transpose(1, 2) / self._scale)

    def of_escape(self) -> Float[Tensor, " c"]:
        """Of what escapes."""
        return self._factor(self.escape)

    @property
    def _scale(self) -> float:
        return float(self.query.shape[1] ** 0.5)

    def _factor(self, score: Tensor) -> Tensor:
        return torch.exp(self.bound * torch.tanh(score))


def of_rays(of_cells: Float[Tensor, "c n"], rows: Int[Tensor, " *rays"]) -> Float[Tensor, " *rays n"]:
    """What each ray brings of the cell that it meets; zeros where it meets none (row C)."""
    with_nothing = torch.cat([of_cells, of_cells.new_zeros(1, of_cells.shape[1])])
    return F.embedding(rows, with_nothing)  # as indexing, with a gradient that is five times as fast on a CPU


def _seen(cells: PackedCells) -> Float[Tensor, "b longest longest_plus_1"]:
    """The share of rays that ends in no cell, and in each."""
    hits = cells.padded(cells.hits + 1)  # [B, C, R]; padding and misses go to column 0
    counted = cells.area.new_zeros(*hits.shape[:2], hits.shape[1] + 1)
    counted.scatter_add_(2, hits, counted.new_ones(1).expand(hits.shape))
    return counted / hits.shape[-1]

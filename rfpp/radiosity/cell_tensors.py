"""Bounces of light between cells."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.radiosity.cells import Cells


@dataclass(frozen=True)
class CellTensors:
    """`Cells` as tensors; rays that escape have row C.

    Albedos are scaled down where diffuse plus specular exceeds 1, so that energy never grows.
    """

    diffuse: Float[Tensor, "c 3"]
    specular: Float[Tensor, "c 3"]
    direct: Float[Tensor, "c 3"]
    highlights: Float[Tensor, "c 3"]
    hits: Int[Tensor, "c rays"]
    onward: Int[Tensor, "c rays"]

    @classmethod
    def of(cls, cells: Cells, device: torch.device | str) -> CellTensors:
        """Move a scene's cells to a device."""
        names = ("diffuse", "specular", "direct", "highlights", "hits", "onward")
        moved = {name: torch.from_numpy(getattr(cells, name)).to(device) for name in names}
        rays = {name: row_of(moved[name], len(cells)) for name in ("hits", "onward")}
        return cls(**{**moved, **rays}).conserving()

    def conserving(self) -> CellTensors:
        """Scale albedos down to a sum of at most 1."""
        scale = 1 / (self.diffuse + self.specular).clamp_min(1.0)
        return replace(self, diffuse=self.diffuse * scale, specular=self.specular * scale)

    def __len__(self) -> int:
        return len(self.diffuse)


@dataclass(frozen=True)
class LitCells:
    """Light at cells after k bounces, as irradiance / π.

    Attributes:
        cells: The cells.
        irradiance: [C, 3] light that has bounced at most k times.
        before: [C, 3] light that has bounced at most k - 1 times.
    """

    cells: CellTensors
    irradiance: Float[Tensor, "c 3"]
    before: Float[Tensor, "c 3"]

    def bounced(self) -> LitCells:
        """Return the light after one more bounce.

        Diffuse light leaves the cell in which a ray ends. Its glossy lobe returns highlights of the emitters and, of
        the light two bounces ago, what the cell sends that the reflected ray meets.
        """
        cells = self.cells
        diffuse = of_rays(cells.diffuse * self.irradiance, cells.hits)
        glossy = of_rays(cells.specular, cells.hits) * of_rays(self.leaving_before, cells.onward)
        return LitCells(cells, cells.direct + cells.highlights + (diffuse + glossy).mean(1), self.irradiance)

    def toward(self, hits: Int[Tensor, "*rays"], onward: Int[Tensor, "*rays"]) -> Float[Tensor, "*rays 3"]:
        """Return the radiance that rays bring from where they end, except direct light reflected there.

        Args:
            hits: Rows of the cells in which rays end.
            onward: Rows of the cells that the glossy lobe sees from there.
        """
        cells = self.cells
        diffuse = of_rays(cells.diffuse * (self.irradiance - cells.direct), hits)
        return diffuse + of_rays(cells.specular, hits) * of_rays(self.leaving_before, onward)

    @property
    def leaving_before(self) -> Float[Tensor, "c 3"]:
        """Radiance that leaves in all directions, of the light one bounce ago."""
        return (self.cells.diffuse + self.cells.specular) * self.before


def lit_directly(cells: CellTensors) -> LitCells:
    """Return cells lit by the emitters alone, from which bounces start."""
    return LitCells(cells, cells.direct, torch.zeros_like(cells.direct))


def row_of(cell: Int[Tensor, "*rays"], cells: int) -> Int[Tensor, "*rays"]:
    """Return cell numbers as int64 rows, with `cells` in place of NOWHERE."""
    return torch.where(cell < 0, cells, cell.long())


def of_rays(of_cells: Float[Tensor, "c n"], rows: Int[Tensor, "*rays"]) -> Float[Tensor, "*rays n"]:
    """Look up a value for each ray; zero for rays that escape (row C)."""
    padded = torch.cat([of_cells, of_cells.new_zeros(1, of_cells.shape[1])])
    return F.embedding(rows, padded)  # as indexing, with a gradient that is five times as fast on a CPU

"""Cells: a scene's surfaces as a few hundred patches between which light is exchanged, as in radiosity.

Light that arrives at a cell leaves it in all directions alike, except for what its glossy lobe sends back along the
rays of others. Form factors are the ends of cosine-distributed rays (Goral et al. 1984; Malley 1988). Direct light is
evaluated where these rays end, never taken from the mean of a cell, because it varies within cells near lights and at
shadows; only light that has bounced before moves between cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from rfpp.radiosity.cell_grid import CellGrid
from rfpp.radiosity.cell_splits import CellSplits
from rfpp.radiosity.cell_table import CellTable, cells_each
from rfpp.raycast.threads import over_rows


@dataclass(frozen=True, eq=False)
class Cells:
    """C cells of one scene.

    Attributes:
        diffuse: Mean diffuse albedo.
        specular: Mean specular albedo.
        direct: Irradiance / π from the emitters, with shadows; for light that reaches a ray by way of two surfaces.
        bounced: Irradiance / π from the surfaces in which the cell's rays end, as the emitters light them.
        hits: Cells in which RAYS cosine-distributed rays end; NOWHERE where a ray escapes.
        onward: Cells in which those rays end after one glossy reflection (`rfpp.radiosity.ray_ends`); NOWHERE if none.
    """

    diffuse: Float[np.ndarray, "c 3"]
    specular: Float[np.ndarray, "c 3"]
    direct: Float[np.ndarray, "c 3"]
    bounced: Float[np.ndarray, "c 3"]
    hits: Int[np.ndarray, "c rays"]
    onward: Int[np.ndarray, "c rays"]

    def __len__(self) -> int:
        return len(self.diffuse)


@dataclass(frozen=True, eq=False)
class CellMap:
    """Map from points of a scene to cells.

    Attributes:
        keys: Keys of the grid, ascending.
        cell: Cell or split of each key; NOWHERE for those that no light can reach.
    """

    grid: CellGrid
    keys: Int[np.ndarray, " k"]
    cell: Int[np.ndarray, " k"]
    splits: CellSplits

    def at(
        self, triangle: Int[np.ndarray, " r"], point: Float[np.ndarray, "r 3"], back: np.ndarray
    ) -> Int[np.ndarray, " r"]:
        """Return the cell of each point on the front or the back of a triangle."""
        found = np.empty(len(triangle), np.int64)
        over_rows(len(found), cells_each, self.table, triangle, point, back, found)
        return found

    @cached_property
    def table(self) -> CellTable:
        """Return arrays for compiled loops."""
        return self.grid.table(self.keys, self.cell, self.splits)

"""Cells: a scene's surfaces as a few hundred pieces between which light is exchanged, as in radiosity.

Light that arrives at a cell leaves it in all directions alike, but for what its glossy lobe sends back along the rays
of others. The first bounce is known of each, with its shadows, and of where its light comes from, the ends of some
rays: the form factors of Goral et al. 1984, found as Malley 1988 has it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer.cell_grid import CellGrid
from rfpp.gbuffer.cell_table import CellTable


@dataclass(frozen=True, eq=False)
class Cells:
    """C cells of a scene.

    Attributes:
        octant: 8 · object + octant, in the object's principal axes, that the cell lies in.
        centre, normal: means over what is seen of it; the second is shorter than 1 where the cell is bent.
        area: of this side, seen or not.
        diffuse, specular, roughness: means.
        emitted: radiance.
        arriving: irradiance / π straight from the emitters, shadows included.
        highlights: irradiance / π of the emitters by way of one glossy lobe.
        hits: the cells that RAYS rays end in, which leave as diffuse light does; NOWHERE for none.
        onward: the cells that the rays end in which the glossy lobe throws on from there (`rfpp.gbuffer.ray_ends`);
            NOWHERE for none.
    """

    octant: Int[np.ndarray, " c"]
    centre: Float[np.ndarray, "c 3"]
    normal: Float[np.ndarray, "c 3"]
    area: Float[np.ndarray, " c"]
    diffuse: Float[np.ndarray, "c 3"]
    specular: Float[np.ndarray, "c 3"]
    roughness: Float[np.ndarray, " c"]
    emitted: Float[np.ndarray, "c 3"]
    arriving: Float[np.ndarray, "c 3"]
    highlights: Float[np.ndarray, "c 3"]
    hits: Int[np.ndarray, "c rays"]
    onward: Int[np.ndarray, "c rays"]

    def __len__(self) -> int:
        return len(self.area)

    def moved(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, " 3"]) -> Cells:
        """After p → rotation · p + translation."""
        turn = rotation.T.astype(np.float32)
        return replace(self, centre=self.centre @ turn + translation.astype(np.float32), normal=self.normal @ turn)

    def recoloured(self, order: Int[np.ndarray, " 3"]) -> Cells:
        """Red, green and blue in another order."""
        coloured = ("diffuse", "specular", "emitted", "arriving", "highlights")
        return replace(self, **{name: getattr(self, name)[:, order] for name in coloured})


@dataclass(frozen=True, eq=False)
class CellMap:
    """Which cell a point of a scene lies in.

    Attributes:
        grid: that the scene is cut up by.
        keys: of the grid, ascending.
        cell: of each key; NOWHERE for those that no light can reach.
    """

    grid: CellGrid
    keys: Int[np.ndarray, " k"]
    cell: Int[np.ndarray, " k"]

    def at(
        self, triangle: Int[np.ndarray, " r"], point: Float[np.ndarray, "r 3"], back: np.ndarray
    ) -> Int[np.ndarray, " r"]:
        """The cell of each point on the front or the back of a triangle."""
        found: np.ndarray = self.table.cell[self.grid.keys(triangle, point, back)]
        return found

    @cached_property
    def table(self) -> CellTable:
        """What loops read."""
        return self.grid.table(self.keys, self.cell)


def parts(cells: Cells) -> dict[str, np.ndarray]:
    """The arrays of `Cells` by name."""
    return {field.name: getattr(cells, field.name) for field in fields(cells)}

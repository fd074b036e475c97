"""What rays meet: the cells they end in, and what the glossy lobe of the surface there sends back along them.

Light that arrives at a cell leaves it in all directions alike; what a shiny surface mirrors does not. So a ray knows
two cells: the one it ends in, whose diffuse light it brings, and the one in which a ray ends that the glossy lobe
throws on from there (the "extended" form factors of Sillion and Puech 1989). Counted as dull, light that falls from the
floor on a rough shiny object returns to the floor; of a lobe, most of it goes on upwards.

As in the reference images, shiny surfaces are blurred in what other surfaces see of them ("Filter Glossy" of Cycles).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer.cell_loops import follow_each
from rfpp.gbuffer.cells import CellMap
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.threads import over_rows


class RayEnds(NamedTuple):
    """Where R rays end.

    Attributes:
        cell: in which cell; NOWHERE for none.
        onward: the cell in which the ray ends that the glossy lobe throws on; NOWHERE for none, and in the share in
            which the lobe, for all that its albedo does not say, sends no light on.
        highlights: radiance of the emitters that comes back along the ray by way of the glossy lobe.
        triangle: on which the ray ends; -1 for none.
        slope: derivative of the highlights by the specular albedo there.
    """

    cell: Int[np.ndarray, " r"]
    onward: Int[np.ndarray, " r"]
    highlights: Float[np.ndarray, "r 3"]
    triangle: Int[np.ndarray, " r"]
    slope: Float[np.ndarray, "r 3"]


def follow_rays(
    sampler: LightSampler,
    cells: CellMap,
    origin: Float[np.ndarray, "r 3"],
    way: Float[np.ndarray, "r 3"],
    density: Float[np.ndarray, " r"],
    rng: np.random.Generator,
) -> RayEnds:
    """Casts rays, and each on from where it ends.

    Args:
        density: per solid angle, with which the surfaces that rays leave send them this way.
    """
    count = len(origin)
    cell, onward, triangle = np.empty((3, count), np.int64)
    highlights, slope = np.empty((2, count, 3))
    ends = RayEnds(cell, onward, highlights, triangle, slope)
    key = int(rng.integers(1 << 62))
    over_rows(count, follow_each, sampler.scene, cells.table, origin, way, density, key, *ends)
    return ends

"""Follow rays to the cells in which they end, and once further along the glossy lobe of the surface there.

Light that arrives at a cell leaves it in all directions alike; what a glossy surface reflects does not. Each ray
therefore has two cells: the one in which it ends, and the one in which its continuation along the glossy lobe ends
("extended" form factors, Sillion and Puech 1989). Glossy surfaces are blurred when seen by other surfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rfpp.radiosity.cell_loops import follow_each
from rfpp.radiosity.cells import CellMap
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.threads import over_rows


class RayEnds(NamedTuple):
    """Ends of R rays.

    Attributes:
        cell: Cell in which the ray ends; NOWHERE if it escapes.
        onward: Cell in which its glossy continuation ends; NOWHERE if it escapes or the lobe absorbs it.
        light: Radiance of the surface there towards the ray's origin, as the emitters light it.
        triangle: Triangle on which the ray ends; -1 if none.
        by_diffuse: Derivative of the light by the diffuse albedo there.
        by_specular: Derivative of the light by the specular albedo there.
    """

    cell: Int[np.ndarray, " r"]
    onward: Int[np.ndarray, " r"]
    light: Float[np.ndarray, "r 3"]
    triangle: Int[np.ndarray, " r"]
    by_diffuse: Float[np.ndarray, "r 3"]
    by_specular: Float[np.ndarray, "r 3"]


def follow_rays(
    sampler: LightSampler,
    cells: CellMap,
    origin: Float[np.ndarray, "r 3"],
    direction: Float[np.ndarray, "r 3"],
    density: Float[np.ndarray, " r"],
    rng: np.random.Generator,
) -> RayEnds:
    """Cast rays, and each one further from where it ends.

    Args:
        density: Probability density per solid angle with which the rays were drawn.
    """
    count = len(origin)
    cell, onward, triangle = np.empty((3, count), np.int64)
    light, by_diffuse, by_specular = np.empty((3, count, 3))
    ends = RayEnds(cell, onward, light, triangle, by_diffuse, by_specular)
    key = int(rng.integers(1 << 62))
    over_rows(count, follow_each, sampler.scene, cells.table, origin, direction, density, key, *ends)
    return ends

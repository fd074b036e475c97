"""Find a scene's cells: where they are, the light that arrives at them, and what they see of each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from rfpp.radiosity.cell_places import RAYS, CellPlaces
from rfpp.radiosity.cells import Cells
from rfpp.radiosity.ray_ends import follow_rays
from rfpp.raycast.direct_light import gathered
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.surface import Surface
from rfpp.raycast.traces import Trace
from rfpp.scene.triangles import DIFFUSE, SPECULAR


@dataclass(frozen=True, eq=False)
class CellSources:
    """Dependence of C cells on the materials of triangles, for gradients.

    Attributes:
        triangle: Triangles of the points over which albedos are averaged.
        cell: Cells of those points.
        bounced: Derivatives of the bounced light.
    """

    triangle: Int[np.ndarray, " p"]
    cell: Int[np.ndarray, " p"]
    bounced: Trace


def cells_at(places: CellPlaces, sampler: LightSampler) -> tuple[Cells, CellSources]:
    """Return the cells at these places, and their dependence on materials."""
    rng = np.random.default_rng(1)
    triangles, seen, rays = sampler.triangles, places.points, places.rays
    from_above = seen.position + places.normal
    surface = Surface.at(triangles, seen.triangle, seen.position, places.normal, from_above)
    diffuse_only = replace(surface, specular=np.zeros_like(surface.specular))  # only irradiance is wanted
    direct = gathered(sampler, diffuse_only, 1, rng)[0]
    ends = follow_rays(sampler, places.map, rays.origin, rays.direction, rays.cosine / np.pi, rng)
    count = np.bincount(places.cell)

    def mean(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(values), -1).T
        return np.stack([np.bincount(places.cell, column) / count for column in columns], axis=-1).astype(np.float32)

    material = triangles.material[seen.triangle]
    cells = Cells(
        diffuse=mean(material[:, DIFFUSE]),
        specular=mean(material[:, SPECULAR]),
        direct=mean(direct),
        bounced=ends.light.reshape(-1, RAYS, 3).mean(1).astype(np.float32),
        hits=ends.cell.reshape(-1, RAYS).astype(np.int32),
        onward=ends.onward.reshape(-1, RAYS).astype(np.int32),
    )
    bounced = Trace.of(len(cells), RAYS)
    bounced.triangle[:] = ends.triangle.clip(0).reshape(-1, RAYS)
    bounced.diffuse[:] = ends.by_diffuse.reshape(-1, RAYS, 3) / RAYS
    bounced.specular[:] = ends.by_specular.reshape(-1, RAYS, 3) / RAYS
    return cells, CellSources(seen.triangle, places.cell, bounced)

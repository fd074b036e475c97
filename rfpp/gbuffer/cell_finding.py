"""A scene's cells: what they see of each other, and the light that arrives at them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from rfpp.gbuffer.cell_places import RAYS, CellPlaces, find_places
from rfpp.gbuffer.cells import CellMap, Cells
from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.ray_ends import follow_rays
from rfpp.gbuffer.surface import Surface
from rfpp.gbuffer.traces import Trace
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR


@dataclass(frozen=True, eq=False)
class CellSources:
    """What the numbers of C cells are made of.

    Attributes:
        triangle, cell: of the points whose means reflectance and emission are.
        highlights: where highlights come from.
    """

    triangle: Int[np.ndarray, " p"]
    cell: Int[np.ndarray, " p"]
    highlights: Trace


def find_cells(sampler: LightSampler) -> tuple[Cells, CellMap]:
    """The cells of a scene and where they are. The same scene gives the same numbers."""
    places = find_places(sampler.triangles, sampler.caster)
    return cells_at(places, sampler)[0], places.map


def cells_at(places: CellPlaces, sampler: LightSampler) -> tuple[Cells, CellSources]:
    """The cells of a scene at their places, and what their numbers are made of."""
    rng = np.random.default_rng(1)
    triangles, seen, rays = sampler.triangles, places.points, places.rays
    from_above = seen.position + places.normal
    surface = Surface.at(triangles, seen.triangle, seen.position, places.normal, from_above)
    dull = replace(surface, specular=np.zeros_like(surface.specular))  # only irradiance is wanted
    arriving = gathered(sampler, dull, 1, rng)[0]
    ends = follow_rays(sampler, places.map, rays.origin, rays.way, rays.cosine / np.pi, rng)
    count = np.bincount(places.cell)

    def mean(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(values), -1).T
        return np.stack([np.bincount(places.cell, column) / count for column in columns], axis=-1).astype(np.float32)

    material = triangles.material[seen.triangle]
    cells = Cells(
        octant=places.octant,
        centre=mean(seen.position),
        normal=mean(places.normal),
        area=places.area,
        diffuse=mean(material[:, DIFFUSE]),
        specular=mean(material[:, SPECULAR]),
        roughness=mean(material[:, ROUGHNESS])[:, 0],
        emitted=mean(material[:, EMISSION]),
        arriving=mean(arriving),
        highlights=ends.highlights.reshape(-1, RAYS, 3).mean(1).astype(np.float32),
        hits=ends.cell.reshape(-1, RAYS).astype(np.int32),
        onward=ends.onward.reshape(-1, RAYS).astype(np.int32),
    )
    highlights = Trace.of(len(cells), RAYS)
    highlights.triangle[:] = ends.triangle.clip(0).reshape(-1, RAYS)
    highlights.specular[:] = ends.slope.reshape(-1, RAYS, 3) / RAYS
    return cells, CellSources(seen.triangle, places.cell, highlights)

"""Finds a scene's cells: where they are, what they see of each other, and the light that arrives at them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer.cell_grid import CellGrid
from rfpp.gbuffer.cell_table import NOWHERE
from rfpp.gbuffer.cells import CellMap, Cells
from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.ray_ends import follow_rays
from rfpp.gbuffer.surface import Surface, cosine_directions, lattice
from rfpp.gbuffer.traces import Trace
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

#: Rays from each cell that say which cells it sees.
RAYS = 64
#: Points on each object that its cells are made of, and so many more for each box of its grid.
_POINTS, _POINTS_PER_BOX = 128, 8
#: Points of a cell at which light is looked for.
_SEEN = 16


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
    return find_cells_and_sources(sampler)[:2]


def find_cells_and_sources(sampler: LightSampler) -> tuple[Cells, CellMap, CellSources]:
    """As `find_cells`, and what their numbers are made of.

    Sides that no light reaches, as the inside of a closed object, are no cells. What is seen of a cell is what counts:
    where a wall goes on behind another one, or an object stands on the floor, no light arrives and none is seen. So
    its light is a mean over where rays from other cells end, and its own rays start there.
    """
    rng = np.random.default_rng(0)
    triangles, grid = sampler.triangles, CellGrid.over(sampler.triangles)
    even, weight = _even_points(sampler, grid, rng)
    keys, cell = np.unique(even.keys(grid), return_inverse=True)
    everywhere = CellMap(grid, keys, np.arange(len(keys)))
    order = np.argsort(cell, kind="stable")
    even, weight, cell = even.part(order), weight[order], cell[order]
    hits, met = _where_light_goes(sampler, everywhere, even, cell, rng)
    kept = _reached(hits, keys, grid)
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, NOWHERE), NOWHERE)
    seen, of_cell = _seen_points(even, cell, met, hits[hits != NOWHERE], renumbered, rng)
    everywhere = CellMap(grid, keys, renumbered[:-1])

    surface = seen.surface(triangles)
    dull = replace(surface, specular=np.zeros_like(surface.specular))  # only irradiance is wanted
    arriving = gathered(sampler, dull, 1, rng)[0]
    origin, way, cosine = _rays(triangles, seen, of_cell, rng)
    ends = follow_rays(sampler, everywhere, origin, way, cosine / np.pi, rng)
    count = np.bincount(of_cell)

    def mean(values: np.ndarray) -> np.ndarray:
        columns = values.reshape(len(values), -1).T
        return np.stack([np.bincount(of_cell, column) / count for column in columns], axis=-1).astype(np.float32)

    material = triangles.material[seen.triangle]
    cells = Cells(
        octant=grid.octants(keys[kept]).astype(np.int32),
        centre=mean(seen.position),
        normal=mean(seen.normal(triangles)),
        area=np.bincount(cell, weight)[kept].astype(np.float32),
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
    return cells, everywhere, CellSources(seen.triangle, of_cell, highlights)


@dataclass(frozen=True, eq=False)
class _Points:
    """R points on the front or the back of triangles."""

    triangle: Int[np.ndarray, " r"]
    position: Float[np.ndarray, "r 3"]
    back: Bool[np.ndarray, " r"]

    def part(self, rows: np.ndarray) -> _Points:
        return _Points(self.triangle[rows], self.position[rows], self.back[rows])

    def keys(self, grid: CellGrid) -> Int[np.ndarray, " r"]:
        return grid.keys(self.triangle, self.position, self.back)

    def normal(self, triangles: SceneTriangles) -> Float[np.ndarray, "r 3"]:
        """Of their side of the triangle."""
        met = np.flatnonzero(np.bincount(self.triangle))  # many points lie on few triangles
        a, b, c = np.moveaxis(triangles.positions[met].astype(np.float64), 1, 0)
        cross = np.cross(b - a, c - a)
        unit = np.zeros((len(triangles), 3))
        unit[met] = cross / np.linalg.norm(cross, axis=-1, keepdims=True)
        facing: np.ndarray = unit[self.triangle] * np.where(self.back, -1.0, 1.0)[:, None]
        return facing

    def surface(self, triangles: SceneTriangles) -> Surface:
        """Seen from straight above."""
        normal = self.normal(triangles)
        return Surface.at(triangles, self.triangle, self.position, normal, self.position + normal)


def _even_points(
    sampler: LightSampler, grid: CellGrid, rng: np.random.Generator
) -> tuple[_Points, Float[np.ndarray, " r"]]:
    """Points spread evenly over both sides of every object, and the area that each stands for."""
    triangles = sampler.triangles
    corners = triangles.positions.astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    steps = np.concatenate([[0], np.cumsum(area)])
    first, last = triangles.object_offsets[:-1], triangles.object_offsets[1:]
    count = np.where(steps[last] > steps[first], _POINTS + _POINTS_PER_BOX * (2 * grid.pieces).prod(-1), 0)
    owner = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    size = (steps[last] - steps[first])[owner]
    along = steps[first][owner] + (nth + 0.5) / count[owner] * size
    triangle = (np.searchsorted(steps, along, side="right") - 1).clip(first[owner], last[owner] - 1)
    root, share = np.sqrt(rng.random((len(owner), 1))), rng.random((len(owner), 1))
    a, b, c = np.moveaxis(corners[triangle], 1, 0)
    position = (1 - root) * a + root * (1 - share) * b + root * share * c
    back = np.repeat([False, True], len(triangle))
    return _Points(np.tile(triangle, 2), np.tile(position, (2, 1)), back), np.tile(size / count[owner], 2)


def _rays(
    triangles: SceneTriangles, points: _Points, cell: Int[np.ndarray, " r"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """RAYS rays from each cell, cell by cell: origins, ways, and cosines with which they leave.

    Args:
        points: where rays start, in turn; at least one of every cell.
        cell: of the points, ascending.
    """
    count = np.bincount(cell)
    start = (np.cumsum(count) - count)[:, None] + np.arange(RAYS) % count[:, None]
    surface = points.part(start.reshape(-1)).surface(triangles)
    way = cosine_directions(surface, lattice(RAYS, rng.random((len(count), 2))).reshape(-1, 2))
    return surface.point, way, (surface.normal * way).sum(-1)


def _where_light_goes(
    sampler: LightSampler, cells: CellMap, points: _Points, cell: Int[np.ndarray, " r"], rng: np.random.Generator
) -> tuple[Int[np.ndarray, "c rays"], _Points]:
    """The cells in which RAYS rays from each cell end, and the ends, of those that end in one."""
    origin, way, _ = _rays(sampler.triangles, points, cell, rng)
    hits = sampler.caster.cast(origin, way)
    met = np.flatnonzero(hits.triangle >= 0)
    triangle, position = hits.triangle[met], origin[met] + hits.distance[met, None] * way[met]
    front = _Points(triangle, position, np.zeros(len(triangle), bool)).normal(sampler.triangles)
    ends = _Points(triangle, position, (front * way[met]).sum(-1) > 0)
    found = np.full(len(origin), NOWHERE)
    found[met] = cells.at(ends.triangle, ends.position, ends.back)
    return found.reshape(-1, RAYS), ends.part(found[met] != NOWHERE)


def _seen_points(
    even: _Points,
    cell: Int[np.ndarray, " r"],
    ends: _Points,
    of_ends: Int[np.ndarray, " e"],
    renumbered: Int[np.ndarray, " c_plus_1"],
    rng: np.random.Generator,
) -> tuple[_Points, Int[np.ndarray, " p"]]:
    """Up to _SEEN points of every cell that is kept, ends of rays or, where too few end, any; and their cells."""
    owner = np.concatenate([renumbered[of_ends], renumbered[cell]])
    later = np.repeat([0, 1], [len(of_ends), len(cell)])
    order = np.argsort(2 * owner + later + rng.random(len(owner)))  # by cell, ends first, in any order
    order = order[owner[order] != NOWHERE]
    owner = owner[order]
    rank = np.arange(len(owner)) - np.searchsorted(owner, owner)
    ended = np.bincount(owner, later[order] == 0)[owner].astype(int)
    enough = np.where(ended >= _SEEN // 2, np.minimum(ended, _SEEN), _SEEN)
    order = order[rank < enough]
    every = (np.concatenate([getattr(p, name) for p in (ends, even)]) for name in ("triangle", "position", "back"))
    return _Points(*every).part(order), owner[rank < enough]


def _reached(hits: Int[np.ndarray, "c rays"], keys: Int[np.ndarray, " c"], grid: CellGrid) -> np.ndarray:
    """[C] bool: the cells from which more can be seen, in any number of steps, than the inside of one object."""
    owner = grid.octants(keys) // 8
    reached: np.ndarray = ((hits == NOWHERE) | (owner[hits] != owner[:, None])).any(-1)
    while (more := reached | (reached[hits] & (hits != NOWHERE)).any(-1)).sum() > reached.sum():
        reached = more
    return reached

"""Where a scene's cells are, and the rays with which they look around: what of them is geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer.cell_grid import CellGrid
from rfpp.gbuffer.cell_table import NOWHERE
from rfpp.gbuffer.cells import CellMap
from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.lit_scene import CLEARANCE
from rfpp.gbuffer.raycast import RayCaster
from rfpp.gbuffer.threads import over_rows
from rfpp.gbuffer.vectors import GOLDEN, added, in_world, scaled, tangents, triple
from rfpp.scene.triangles import SceneTriangles

#: Rays from each cell that say which cells it sees.
RAYS = 64
#: Points on each object that its cells are made of, and so many more for each box of its grid.
_POINTS, _POINTS_PER_BOX = 128, 8
#: Points of a cell at which light is looked for.
_SEEN = 16


@dataclass(frozen=True, eq=False)
class Rays:
    """RAYS rays from each cell, cell by cell, as dense as diffuse light leaves it.

    Attributes:
        origin, way: where they start, unit directions.
        cosine: with which they leave.
    """

    origin: Float[np.ndarray, "n 3"]
    way: Float[np.ndarray, "n 3"]
    cosine: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class CellPlaces:
    """Where the C cells of a scene are.

    Attributes:
        map: of points to cells.
        octant, area: see `Cells`.
        points: at which their light and their materials are looked for.
        cell: of each point, ascending.
        normal: of the points' side of their triangles.
        rays: that start there.
    """

    map: CellMap
    octant: Int[np.ndarray, " c"]
    area: Float[np.ndarray, " c"]
    points: SidePoints
    cell: Int[np.ndarray, " p"]
    normal: Float[np.ndarray, "p 3"]
    rays: Rays


def find_places(triangles: SceneTriangles, caster: RayCaster) -> CellPlaces:
    """Of a scene's cells.

    Sides that no light reaches, as the inside of a closed object, are no cells. What is seen of a cell is what counts:
    where a wall goes on behind another one, or an object stands on the floor, no light arrives and none is seen. So
    its points are where rays from other cells end.

    Args:
        caster: over all triangles.
    """
    rng = np.random.default_rng(0)
    grid = CellGrid.over(triangles)
    even, weight = _even_points(triangles, grid, rng)
    keys_of_points = even.keys(grid)
    keys = np.flatnonzero(np.bincount(keys_of_points))
    cell = np.searchsorted(keys, keys_of_points)
    everywhere = CellMap(grid, keys, np.arange(len(keys)))
    order = np.argsort(cell, kind="stable")
    even, weight, cell = even.part(order), weight[order], cell[order]
    hits, met = _where_light_goes(triangles, caster, everywhere, even, cell, rng)
    kept = _reached(hits, keys, grid)
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, NOWHERE), NOWHERE)
    seen, of_cell = _seen_points(even, cell, met, hits[hits != NOWHERE], renumbered, rng)
    normal = seen.normal(triangles)
    return CellPlaces(
        map=CellMap(grid, keys, renumbered[:-1]),
        octant=grid.octants(keys[kept]).astype(np.int32),
        area=np.bincount(cell, weight)[kept].astype(np.float32),
        points=seen,
        cell=of_cell,
        normal=normal,
        rays=_rays(seen.position, normal, of_cell, rng),
    )


@dataclass(frozen=True, eq=False)
class SidePoints:
    """R points on the front or the back of triangles."""

    triangle: Int[np.ndarray, " r"]
    position: Float[np.ndarray, "r 3"]
    back: Bool[np.ndarray, " r"]

    def part(self, rows: np.ndarray) -> SidePoints:
        return SidePoints(self.triangle[rows], self.position[rows], self.back[rows])

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


def _even_points(
    triangles: SceneTriangles, grid: CellGrid, rng: np.random.Generator
) -> tuple[SidePoints, Float[np.ndarray, " r"]]:
    """Points spread evenly over both sides of every object, and the area that each stands for."""
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
    return SidePoints(np.tile(triangle, 2), np.tile(position, (2, 1)), back), np.tile(size / count[owner], 2)


def _rays(
    position: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    cell: Int[np.ndarray, " r"],
    rng: np.random.Generator,
) -> Rays:
    """Of each cell.

    Args:
        position, normal: of points where rays start, in turn; at least one of every cell.
        cell: of the points, ascending.
    """
    count = np.bincount(cell)
    origin, way = np.empty((2, RAYS * len(count), 3))
    cosine = np.empty(RAYS * len(count))
    starts = position, normal, np.cumsum(count) - count, count
    over_rows(len(cosine), _leave, *starts, rng.random((len(count), 2)), origin, way, cosine)
    return Rays(origin, way, cosine)


@compiled
def _leave(
    start: int,
    stop: int,
    position: Float[np.ndarray, "p 3"],
    normal: Float[np.ndarray, "p 3"],
    first: Int[np.ndarray, " c"],
    count: Int[np.ndarray, " c"],
    shift: Float[np.ndarray, "c 2"],
    origin: Float[np.ndarray, "n 3"],
    way: Float[np.ndarray, "n 3"],
    cosine: Float[np.ndarray, " n"],
) -> None:
    """Fills in `Rays`: points of a lattice, displaced cell by cell (Cranley and Patterson 1976), on a disc, lifted
    (Malley 1988)."""
    for row in range(start, stop):
        cell, nth = row // RAYS, row % RAYS
        point = first[cell] + nth % count[cell]
        u, v = ((nth + 0.5) / RAYS + shift[cell, 0]) % 1, (nth * GOLDEN + shift[cell, 1]) % 1
        radius, angle, lifted = np.sqrt(u), 2 * np.pi * v, np.sqrt(1 - u)
        upwards = triple(normal[point])
        first_axis, second_axis = tangents(upwards)
        toward = in_world((radius * np.cos(angle), radius * np.sin(angle), lifted), first_axis, second_axis, upwards)
        here = added(triple(position[point]), scaled(upwards, CLEARANCE))
        for k in range(3):
            origin[row, k], way[row, k] = here[k], toward[k]
        cosine[row] = lifted


def _where_light_goes(
    triangles: SceneTriangles,
    caster: RayCaster,
    cells: CellMap,
    points: SidePoints,
    cell: Int[np.ndarray, " r"],
    rng: np.random.Generator,
) -> tuple[Int[np.ndarray, "c rays"], SidePoints]:
    """The cells in which RAYS rays from each cell end, and the ends, of those that end in one."""
    rays = _rays(points.position, points.normal(triangles), cell, rng)
    origin, way = rays.origin, rays.way
    hits = caster.cast(origin, way)
    met = np.flatnonzero(hits.triangle >= 0)
    triangle, position = hits.triangle[met], origin[met] + hits.distance[met, None] * way[met]
    front = SidePoints(triangle, position, np.zeros(len(triangle), bool)).normal(triangles)
    ends = SidePoints(triangle, position, (front * way[met]).sum(-1) > 0)
    found = np.full(len(origin), NOWHERE)
    found[met] = cells.at(ends.triangle, ends.position, ends.back)
    return found.reshape(-1, RAYS), ends.part(found[met] != NOWHERE)


def _seen_points(
    even: SidePoints,
    cell: Int[np.ndarray, " r"],
    ends: SidePoints,
    of_ends: Int[np.ndarray, " e"],
    renumbered: Int[np.ndarray, " c_plus_1"],
    rng: np.random.Generator,
) -> tuple[SidePoints, Int[np.ndarray, " p"]]:
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
    return SidePoints(*every).part(order), owner[rank < enough]


def _reached(hits: Int[np.ndarray, "c rays"], keys: Int[np.ndarray, " c"], grid: CellGrid) -> np.ndarray:
    """[C] bool: the cells from which more can be seen, in any number of steps, than the inside of one object."""
    owner = grid.octants(keys) // 8
    reached: np.ndarray = ((hits == NOWHERE) | (owner[hits] != owner[:, None])).any(-1)
    while (more := reached | (reached[hits] & (hits != NOWHERE)).any(-1)).sum() > reached.sum():
        reached = more
    return reached

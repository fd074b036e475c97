"""Place a scene's cells and their rays: the part of finding cells that depends on geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.radiosity.cell_grid import CellGrid
from rfpp.radiosity.cell_splits import split_cells
from rfpp.radiosity.cell_table import NOWHERE
from rfpp.radiosity.cells import CellMap
from rfpp.raycast.compiled import compiled
from rfpp.raycast.lit_scene import CLEARANCE
from rfpp.raycast.raycast import RayCaster
from rfpp.raycast.threads import over_rows
from rfpp.raycast.vectors import GOLDEN, added, in_world, scaled, tangents, triple
from rfpp.scene.triangles import SceneTriangles

#: Rays per cell that sample its form factors.
RAYS = 128
#: Sample points per object, and further ones per box of its grid; those of an object that is not divided.
_POINTS, _POINTS_PER_BOX, _OF_UNDIVIDED = 128, 8, 16
#: Points per cell at which light is sampled.
_SEEN = 16


@dataclass(frozen=True, eq=False)
class Rays:
    """RAYS cosine-distributed rays from each cell, cell by cell."""

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    cosine: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class CellPlaces:
    """Places of the C cells of a scene.

    Attributes:
        points: Points at which light and materials of cells are sampled.
        cell: Cell of each point, ascending.
        normal: Normal of each point, on its side of the triangle.
        rays: Rays that start at the points.
    """

    map: CellMap
    points: SidePoints
    cell: Int[np.ndarray, " p"]
    normal: Float[np.ndarray, "p 3"]
    rays: Rays


def find_places(triangles: SceneTriangles, caster: RayCaster) -> CellPlaces:
    """Place the cells of a scene.

    Sides that no light reaches, like the inside of a closed object, get no cells. Points of a cell are where rays from
    other cells end, because hidden parts (a wall behind another, a floor under an object) neither receive light nor
    are seen.
    """
    rng = np.random.default_rng(0)
    grid = CellGrid.over(triangles)
    even = even_points(triangles, grid, rng)
    keys_of_points = even.keys(grid)
    keys = np.flatnonzero(np.bincount(keys_of_points))
    whole = np.searchsorted(keys, keys_of_points)
    divided = np.unique(whole[grid.is_divided[triangles.object_index[even.triangle]]])
    entry, splits, cell = split_cells(triangles, caster, even.position, even.normal(triangles), whole, divided)
    owner_of_cell = np.empty(cell.max() + 1, np.int64)
    owner_of_cell[cell] = triangles.object_index[even.triangle]
    everywhere = CellMap(grid, keys, entry, splits)
    order = np.argsort(cell, kind="stable")
    even, cell = even.part(order), cell[order]
    hits, hit = _where_light_goes(triangles, caster, everywhere, even, cell, rng)
    kept = _reached(hits, owner_of_cell)
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, NOWHERE), NOWHERE)
    seen, of_cell = _seen_points(even, cell, hit, hits[hits != NOWHERE], renumbered, rng)
    normal = seen.normal(triangles)
    return CellPlaces(
        map=CellMap(grid, keys, np.where(entry >= 0, renumbered[entry], entry), splits.renumbered(renumbered)),
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
        """Return the unit normals on the points' side of their triangles."""
        hit = np.flatnonzero(np.bincount(self.triangle))  # many points lie on few triangles
        a, b, c = np.moveaxis(triangles.positions[hit].astype(np.float64), 1, 0)
        cross = np.cross(b - a, c - a)
        unit = np.zeros((len(triangles), 3))
        unit[hit] = cross / np.linalg.norm(cross, axis=-1, keepdims=True)
        facing: np.ndarray = unit[self.triangle] * np.where(self.back, -1.0, 1.0)[:, None]
        return facing


def even_points(triangles: SceneTriangles, grid: CellGrid, rng: np.random.Generator) -> SidePoints:
    """Return points spread evenly over both sides of every object."""
    corners = triangles.positions.astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    steps = np.concatenate([[0], np.cumsum(area)])
    first, last = triangles.object_offsets[:-1], triangles.object_offsets[1:]
    wanted = np.where(grid.is_divided, _POINTS + _POINTS_PER_BOX * (2 * grid.pieces).prod(-1), _OF_UNDIVIDED)
    count = np.where(steps[last] > steps[first], wanted, 0)
    owner = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    size = (steps[last] - steps[first])[owner]
    along = steps[first][owner] + (nth + 0.5) / count[owner] * size
    triangle = (np.searchsorted(steps, along, side="right") - 1).clip(first[owner], last[owner] - 1)
    root, share = np.sqrt(rng.random((len(owner), 1))), rng.random((len(owner), 1))
    a, b, c = np.moveaxis(corners[triangle], 1, 0)
    position = (1 - root) * a + root * (1 - share) * b + root * share * c
    back = np.repeat([False, True], len(triangle))
    return SidePoints(np.tile(triangle, 2), np.tile(position, (2, 1)), back)


def _rays(
    position: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    cell: Int[np.ndarray, " r"],
    rng: np.random.Generator,
) -> Rays:
    """Return RAYS rays for each cell.

    Args:
        position: Points from which rays start in turn; at least one per cell.
        cell: Their cells, ascending.
    """
    count = np.bincount(cell)
    origin, direction = np.empty((2, RAYS * len(count), 3))
    cosine = np.empty(RAYS * len(count))
    starts = position, normal, np.cumsum(count) - count, count
    over_rows(len(cosine), _leave, *starts, rng.random((len(count), 2)), origin, direction, cosine)
    return Rays(origin, direction, cosine)


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
    direction: Float[np.ndarray, "n 3"],
    cosine: Float[np.ndarray, " n"],
) -> None:
    """Fill in `Rays`: points of a lattice displaced for each cell (Cranley and Patterson 1976), by Malley's method."""
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
            origin[row, k], direction[row, k] = here[k], toward[k]
        cosine[row] = lifted


def _where_light_goes(
    triangles: SceneTriangles,
    caster: RayCaster,
    cells: CellMap,
    points: SidePoints,
    cell: Int[np.ndarray, " r"],
    rng: np.random.Generator,
) -> tuple[Int[np.ndarray, "c rays"], SidePoints]:
    """Return the cells in which RAYS rays from each cell end, and the end points of those that hit one."""
    rays = _rays(points.position, points.normal(triangles), cell, rng)
    origin, direction = rays.origin, rays.direction
    hits = caster.cast(origin, direction)
    hit = np.flatnonzero(hits.triangle >= 0)
    triangle, position = (
        hits.triangle[hit],
        origin[hit] + hits.distance[hit, None] * direction[hit],
    )
    front = SidePoints(triangle, position, np.zeros(len(triangle), bool)).normal(triangles)
    ends = SidePoints(triangle, position, (front * direction[hit]).sum(-1) > 0)
    found = np.full(len(origin), NOWHERE)
    found[hit] = cells.at(ends.triangle, ends.position, ends.back)
    return found.reshape(-1, RAYS), ends.part(found[hit] != NOWHERE)


def _seen_points(
    even: SidePoints,
    cell: Int[np.ndarray, " r"],
    ends: SidePoints,
    of_ends: Int[np.ndarray, " e"],
    renumbered: Int[np.ndarray, " c_plus_1"],
    rng: np.random.Generator,
) -> tuple[SidePoints, Int[np.ndarray, " p"]]:
    """Return up to _SEEN points of every kept cell, preferably ends of rays, and their cells."""
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


def _reached(hits: Int[np.ndarray, "c rays"], owner: Int[np.ndarray, " c"]) -> np.ndarray:
    """Return a mask [C] of the cells from which light of more than one object's inside can be reached."""
    reached: np.ndarray = ((hits == NOWHERE) | (owner[hits] != owner[:, None])).any(-1)
    while (more := reached | (reached[hits] & (hits != NOWHERE)).any(-1)).sum() > reached.sum():
        reached = more
    return reached

"""Cells: a scene's surfaces as a few hundred pieces between which light is exchanged, as in radiosity.

Light that arrives at a cell leaves it in all directions alike. The first bounce is known of each, with its shadows, and
of where its own light goes, the ends of some rays: the form factors of Goral et al. 1984, found as Malley 1988 has it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer.cell_grid import CellGrid
from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.raycast import Hits
from rfpp.gbuffer.surface import Surface, lattice
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

#: Rays from each cell that say which cells it sees.
RAYS = 64
#: Points on each object that its cells are made of, and so many more for each box of its grid.
_POINTS, _POINTS_PER_BOX = 128, 8
#: Points of a cell at which light is looked for.
_SEEN = 16
#: What a ray's end is called that meets no cell.
NOWHERE = -1


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
        hits: the cells that RAYS rays end in, which leave as diffuse light does; NOWHERE for none.
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
    hits: Int[np.ndarray, "c rays"]

    def __len__(self) -> int:
        return len(self.area)

    def moved(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, " 3"]) -> Cells:
        """After p → rotation · p + translation."""
        turn = rotation.T.astype(np.float32)
        return replace(self, centre=self.centre @ turn + translation.astype(np.float32), normal=self.normal @ turn)

    def recoloured(self, order: Int[np.ndarray, " 3"]) -> Cells:
        """Red, green and blue in another order."""
        coloured = ("diffuse", "specular", "emitted", "arriving")
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
        keys = self.grid.keys(triangle, point, back)
        row = np.searchsorted(self.keys, keys).clip(max=len(self.keys) - 1)
        # cells so small that none of our points lay there: any of their octant and side
        other = np.searchsorted(self._coarse_keys, self.grid.coarse(keys)).clip(max=len(self._coarse_keys) - 1)
        known = self._coarse_keys[other] == self.grid.coarse(keys)
        return np.where(
            self.keys[row] == keys, self.cell[row], np.where(known, self.cell[self._coarse[other]], NOWHERE)
        )

    @cached_property
    def _coarse(self) -> Int[np.ndarray, " k"]:
        """Of the keys of each octant's side, the first."""
        return np.unique(self.grid.coarse(self.keys), return_index=True)[1]

    @cached_property
    def _coarse_keys(self) -> Int[np.ndarray, " k"]:
        return self.grid.coarse(self.keys[self._coarse])

    def of_hits(
        self, origin: Float[np.ndarray, "r 3"], way: Float[np.ndarray, "r 3"], hits: Hits
    ) -> Int[np.ndarray, " r"]:
        """The cell that each ray ends in."""
        cell = np.full(len(origin), NOWHERE)
        met = np.flatnonzero(hits.triangle >= 0)
        if len(met):
            triangle, way = hits.triangle[met], way[met]
            back = (self._normals(triangle) * way).sum(-1) > 0
            cell[met] = self.at(triangle, origin[met] + hits.distance[met, None] * way, back)
        return cell

    def _normals(self, triangle: Int[np.ndarray, " r"]) -> Float[np.ndarray, "r 3"]:
        a, b, c = np.moveaxis(self.grid.triangles.positions[triangle].astype(np.float64), 1, 0)
        return np.cross(b - a, c - a)


def find_cells(sampler: LightSampler) -> tuple[Cells, CellMap]:
    """The cells of a scene and where they are. The same scene gives the same numbers.

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
    hits, ends = _where_light_goes(sampler, everywhere, even, cell, rng)
    kept = _reached(hits, keys, grid)
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, NOWHERE), NOWHERE)
    seen, of_cell = _seen_points(even, cell, ends, hits[hits != NOWHERE], renumbered, rng)
    everywhere = CellMap(grid, keys, renumbered[:-1])

    surface = seen.surface(triangles)
    dull = replace(surface, specular=np.zeros_like(surface.specular))  # only irradiance is wanted
    arriving = gathered(sampler, dull, 1, rng)[0]
    hits, _ = _where_light_goes(sampler, everywhere, seen, of_cell, rng)
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
        hits=hits.astype(np.int32),
    )
    return cells, everywhere


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
        a, b, c = np.moveaxis(triangles.positions[self.triangle].astype(np.float64), 1, 0)
        cross = np.cross(b - a, c - a)
        return cross / np.linalg.norm(cross, axis=-1, keepdims=True) * np.where(self.back, -1.0, 1.0)[:, None]

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


def _where_light_goes(
    sampler: LightSampler, cells: CellMap, points: _Points, cell: Int[np.ndarray, " r"], rng: np.random.Generator
) -> tuple[Int[np.ndarray, "c rays"], _Points]:
    """The cells in which RAYS rays from each cell end, and the ends, of those that end in one.

    Args:
        points: where rays start, in turn; at least one of every cell.
        cell: of the points, ascending.
    """
    triangles, count = sampler.triangles, np.bincount(cell)
    start = (np.cumsum(count) - count)[:, None] + np.arange(RAYS) % count[:, None]
    rays = points.part(start.reshape(-1)).surface(triangles)
    way = cosine_directions(rays, lattice(RAYS, rng.random((len(count), 2))).reshape(-1, 2))
    hits = sampler.caster.cast(rays.point, way)
    found = cells.of_hits(rays.point, way, hits)
    met = found != NOWHERE
    triangle, position = hits.triangle[met], rays.point[met] + hits.distance[met, None] * way[met]
    front = _Points(triangle, position, np.zeros(len(triangle), bool)).normal(triangles)
    return found.reshape(-1, RAYS), _Points(triangle, position, (front * way[met]).sum(-1) > 0)


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
    order = np.lexsort([rng.random(len(owner)), later, owner])
    order = order[owner[order] != NOWHERE]
    owner = owner[order]
    rank = np.arange(len(owner)) - np.searchsorted(owner, owner)
    ended = np.bincount(owner, later[order] == 0)[owner].astype(int)
    enough = np.where(ended >= _SEEN // 2, np.minimum(ended, _SEEN), _SEEN)
    order = order[rank < enough]
    every = (np.concatenate([getattr(p, name) for p in (ends, even)]) for name in ("triangle", "position", "back"))
    return _Points(*every).part(order), owner[rank < enough]


def cosine_directions(surface: Surface, random: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 3"]:
    """World directions as dense as diffuse light arrives from them: points of a disc, lifted (Malley 1988)."""
    radius, angle = np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - random[:, 0])], axis=-1)
    return np.einsum("rk,rkx->rx", local, surface.frame())


def _reached(hits: Int[np.ndarray, "c rays"], keys: Int[np.ndarray, " c"], grid: CellGrid) -> np.ndarray:
    """[C] bool: the cells from which more can be seen, in any number of steps, than the inside of one object."""
    owner = grid.octants(keys) // 8
    reached = ((hits == NOWHERE) | (owner[hits] != owner[:, None])).any(-1)
    while (more := reached | (reached[hits] & (hits != NOWHERE)).any(-1)).sum() > reached.sum():
        reached = more
    return reached


def parts(cells: Cells) -> dict[str, np.ndarray]:
    """The arrays of `Cells` by name."""
    return {field.name: getattr(cells, field.name) for field in fields(cells)}

"""Division of a scene's surfaces into cells, pieces small enough to have one brightness."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.radiosity.cell_splits import NO_SPLITS, CellSplits
from rfpp.radiosity.cell_table import DIRECTIONS, MOST_PIECES, NOWHERE, SIDES, CellTable, keys_each
from rfpp.raycast.threads import over_rows
from rfpp.scene.triangles import SceneTriangles

#: Approximate edge of a cell, in world units.
CELL_EDGE = 0.1
#: In scenes of more objects, those that are smaller than a cell are not divided.
CROWD = 1000
#: Largest number of triangles for which edges are searched; cosine between normals below which they meet at a crease.
_MOST_TRIANGLES, _CREASE = 4096, 0.87
#: Moments closer than this share belong to a symmetric object, whose axes they do not determine.
_SYMMETRIC = 1e-3


@dataclass(frozen=True, eq=False)
class CellGrid:
    """Grids along the principal axes of each object, so that cells move with it.

    A cell is the surface in one box of the grid that faces one direction: walls that meet in a corner are lit
    differently, as are the two sides of a sheet.

    Attributes:
        centroid: Centroid of each object's surface.
        axes: Principal axes as rows, longest first.
        half: Reach along the axes.
        pieces: Number of boxes on either side of the centroid; 0 for objects that are not divided: their axes and
            centroid are not used, and each of their sides is one cell, whatever direction it faces.
    """

    triangles: SceneTriangles
    centroid: Float[np.ndarray, "o 3"]
    axes: Float[np.ndarray, "o 3 3"]
    half: Float[np.ndarray, "o 3"]
    pieces: Int[np.ndarray, "o 3"]

    @classmethod
    def over(cls, triangles: SceneTriangles) -> CellGrid:
        """Divide the objects of a scene."""
        bounds = triangles.object_offsets
        count = len(bounds) - 1
        centroid, half, pieces = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3), np.int64)
        axes = np.tile(np.eye(3), (count, 1, 1))
        for number in np.flatnonzero(~_undivided(triangles)):
            part = triangles.positions[bounds[number] : bounds[number + 1]].astype(np.float64)
            centroid[number], axes[number] = principal_axes(part)
            away = part.reshape(-1, 3) - centroid[number]
            half[number] = np.abs(np.einsum("ri,ki->rk", away, axes[number])).max(0)
            pieces[number] = np.clip(np.rint(half[number] / CELL_EDGE), 1, MOST_PIECES)
        return cls(triangles, centroid, axes, half, pieces)

    @property
    def is_divided(self) -> Bool[np.ndarray, " o"]:
        """Return the mask of objects that are divided into boxes."""
        divided: np.ndarray = self.pieces[:, 0] > 0
        return divided

    @cached_property
    def _direction(self) -> Int[np.ndarray, " m"]:
        """Return the direction that each triangle faces, in its object's axes."""
        corners = self.triangles.positions.astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        local = np.einsum("mij,mj->mi", self.axes[self.triangles.object_index], normal)
        axis = np.abs(local).argmax(-1)
        direction: np.ndarray = 2 * axis + (np.take_along_axis(local, axis[:, None], 1)[:, 0] < 0)
        return direction

    @cached_property
    def first(self) -> Int[np.ndarray, " o_plus_1"]:
        """First key of each object, and the number of keys."""
        count = np.where(self.is_divided, 8 * self._keys_of_octant, SIDES)
        first: np.ndarray = np.concatenate([[0], np.cumsum(count)])
        return first

    @property
    def _keys_of_octant(self) -> Int[np.ndarray, " o"]:
        count: np.ndarray = self.pieces.prod(-1).clip(1) * DIRECTIONS * SIDES
        return count

    def keys(
        self, triangle: Int[np.ndarray, " r"], point: Float[np.ndarray, "r 3"], back: np.ndarray
    ) -> Int[np.ndarray, " r"]:
        """Return the key of each point on the front or the back of a triangle; equal for points of one cell."""
        keys = np.empty(len(triangle), np.int64)
        over_rows(len(keys), keys_each, self._table(np.zeros(0, np.int64), NO_SPLITS), triangle, point, back, keys)
        return keys

    def table(self, keys: Int[np.ndarray, " k"], cell: Int[np.ndarray, " k"], splits: CellSplits) -> CellTable:
        """Return arrays for compiled loops, with the cells or splits of these keys, which ascend."""
        coarse, first = np.unique(self._sides_of_octants(keys), return_index=True)
        of_side = np.full(8 * SIDES * len(self.pieces), NOWHERE)
        of_side[coarse] = cell[first]
        every = of_side[self._sides_of_octants(np.arange(self.first[-1]))]
        every[keys] = cell
        return self._table(every, splits)

    def _table(self, cell: Int[np.ndarray, " keys"], splits: CellSplits) -> CellTable:
        owner = self.triangles.object_index.astype(np.int64)
        placed = self.centroid, self.axes, self.half, self.pieces
        return CellTable(owner, self._direction, *placed, self.first[:-1], cell, splits.plane, splits.child)

    def octants(self, keys: Int[np.ndarray, " c"]) -> Int[np.ndarray, " c"]:
        """Return 8 · object + octant of each cell."""
        owner = np.searchsorted(self.first, keys, side="right") - 1
        octants: np.ndarray = 8 * owner + (keys - self.first[owner]) // self._keys_of_octant[owner]
        return octants

    def _sides_of_octants(self, keys: Int[np.ndarray, " c"]) -> Int[np.ndarray, " c"]:
        sides: np.ndarray = self.octants(keys) * SIDES + keys % SIDES
        return sides


def _undivided(triangles: SceneTriangles) -> Bool[np.ndarray, " o"]:
    """Return the mask of small objects in a crowded scene."""
    first = triangles.object_offsets[:-1]
    if len(first) <= CROWD:
        return np.zeros(len(first), np.bool_)
    low = np.minimum.reduceat(triangles.positions.min(1), first)
    high = np.maximum.reduceat(triangles.positions.max(1), first)
    small: np.ndarray = np.linalg.norm(high - low, axis=-1) < CELL_EDGE
    return small


def principal_axes(corners: Float[np.ndarray, "m 3 3"]) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Return the centroid of a surface and its principal axes, as rows, longest first, each towards the heavier tail.

    Second moments are exact over triangles. Axes that symmetry leaves open follow the longest edge of the object's
    outline or crease, so that cells of walls and boxes are parallel to them; without edges they point to the farthest
    vertex. Ties go to the first in order, never to rounding, which differs between processors.
    """
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    area = area / max(area.sum(), 1e-30)
    centroid = np.einsum("m,mi->i", area, corners.mean(1))
    spread = corners - centroid
    total = spread.sum(1)
    weighted = (area[:, None, None] * spread).reshape(-1, 3).T @ spread.reshape(-1, 3)
    moment = (weighted + (area[:, None] * total).T @ total) / 12
    size, vectors = np.linalg.eigh(moment)
    vertices, axes = spread.reshape(-1, 3), []
    open_axes = [vectors[:, k] for k in (2, 1, 0)]
    sizes = size[::-1].tolist()
    while open_axes:
        alike = [axis for axis, s in zip(open_axes, sizes, strict=True) if sizes[0] - s <= _SYMMETRIC * size[-1]]
        if len(alike) > 1:
            plane = np.stack(alike)
            edges = feature_edges(corners) @ plane.T
            within = edges if len(edges) and np.square(edges).sum() > 0 else vertices @ plane.T
            farthest = within[_first_largest(np.square(within).sum(-1))]
            turned = np.linalg.qr(np.column_stack([farthest, np.eye(len(alike))]))[0].T @ np.stack(alike)
            open_axes[: len(alike)] = list(turned)
        axes.append(open_axes.pop(0))
        sizes.pop(0)
    rows = np.stack(axes)
    tail = np.einsum("m,mk->k", area, np.einsum("mi,ki->mk", corners.mean(1) - centroid, rows) ** 3)
    along = np.einsum("vi,ki->vk", vertices, rows)
    ends = np.array([row[_first_largest(np.abs(row))] for row in along.T])
    side = np.where(np.abs(tail) > _SYMMETRIC * np.abs(ends) ** 3, tail, ends)
    rows = rows * np.where(side < 0, -1.0, 1.0)[:, None]
    if abs(ends[2]) <= _SYMMETRIC * abs(ends[0]):  # flat
        rows[2] = np.cross(rows[0], rows[1])
    return centroid, rows


def feature_edges(corners: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the vectors of the edges at outlines and creases, where fewer or more than two flush triangles meet."""
    if len(corners) > _MOST_TRIANGLES:
        return np.zeros((0, 3))
    reach = max(np.abs(corners - corners[0, 0]).max(), 1e-30)
    places = np.rint((corners.reshape(-1, 3) - corners[0, 0]) / (1e-5 * reach)).astype(np.int64)
    vertex = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1, 3)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=-1, keepdims=True), 1e-30)
    ends = np.sort(vertex[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    vector = (corners[:, [1, 2, 0]] - corners).reshape(-1, 3)
    _, first, edge, count = np.unique(ends, axis=0, return_index=True, return_inverse=True, return_counts=True)
    edge, of_edge = edge.reshape(-1), np.repeat(normal, 3, axis=0)
    flush = np.full(len(first), np.inf)
    np.minimum.at(flush, edge, np.abs((of_edge * of_edge[first[edge]]).sum(-1)))
    features: Float[np.ndarray, "n 3"] = vector[np.sort(first[(count != 2) | (flush < _CREASE)])]
    return features


def _first_largest(values: Float[np.ndarray, " n"]) -> int:
    """Return the index of the first value that is largest but for rounding."""
    return int(np.argmax(values >= values.max() * (1 - _SYMMETRIC)))

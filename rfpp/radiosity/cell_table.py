"""Table from points of triangles to cells, for compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.raycast.compiled import compiled, int64
from rfpp.raycast.vectors import Vector, dot, triple

#: Cell of a ray that hits none.
NOWHERE = -1
#: Largest number of boxes along an axis of half an object.
MOST_PIECES = 10
#: An object is flat along an axis if it reaches less than this share of its greatest reach.
FLAT = 1e-4
#: Directions of a triangle in its object's axes: forwards or backwards along one of three; and its two sides.
DIRECTIONS, SIDES = 6, 2


class CellTable(NamedTuple):
    """Arrays of a `CellMap`.

    Attributes:
        owner, direction: Object of each triangle, and the direction it faces in the object's axes.
        centroid, axes, half, pieces: See `CellGrid`.
        first: First key of each object.
        cell: Cell of every possible key; for boxes without sample points, a cell of the same octant and side. NOWHERE
            if there is none or no light reaches it; below that a split (`rfpp.radiosity.cell_splits`).
        plane, child: See `CellSplits`.
    """

    owner: Int[np.ndarray, " m"]
    direction: Int[np.ndarray, " m"]
    centroid: Float[np.ndarray, "o 3"]
    axes: Float[np.ndarray, "o 3 3"]
    half: Float[np.ndarray, "o 3"]
    pieces: Int[np.ndarray, "o 3"]
    first: Int[np.ndarray, " o"]
    cell: Int[np.ndarray, " keys"]
    plane: Float[np.ndarray, "s 4"]
    child: Int[np.ndarray, "s 2"]


@compiled
def cell_at(table: CellTable, triangle: int, point: Vector, back: bool) -> int:
    """Return the cell of a point on the front or the back of a triangle; NOWHERE if none."""
    cell: int = table.cell[key_at(table, triangle, point, back)]
    while cell < NOWHERE:
        split = NOWHERE - 1 - cell
        plane = table.plane[split]
        cell = table.child[split, 1 if dot(plane, point) > plane[3] else 0]
    return cell


@compiled
def cells_each(
    start: int,
    stop: int,
    table: CellTable,
    triangle: Int[np.ndarray, " r"],
    points: Float[np.ndarray, "r 3"],
    back: Bool[np.ndarray, " r"],
    cells: Int[np.ndarray, " r"],
) -> None:
    """Fill in the cells of points; see `cell_at`."""
    for row in range(start, stop):
        cells[row] = cell_at(table, triangle[row], triple(points[row]), back[row])


@compiled
def key_at(table: CellTable, triangle: int, point: Vector, back: bool) -> int:
    """Return the key of a point on the front or the back of a triangle; equal for points of one cell."""
    owner = table.owner[triangle]
    first: int = table.first[owner]
    if table.pieces[owner, 0] == 0:
        return first + back
    half, pieces, center = table.half[owner], table.pieces[owner], table.centroid[owner]
    flat = FLAT * max(half[0], half[1], half[2])
    away = (point[0] - center[0], point[1] - center[1], point[2] - center[2])
    octant, box = 0, 0
    for k in range(3):
        place = pieces[k]
        if half[k] >= flat:  # else rounding alone would decide on which side a point lies
            place += int64(np.floor(dot(table.axes[owner, k], away) / max(half[k], 1e-9) * pieces[k]))
        place = min(max(place, 0), 2 * pieces[k] - 1)
        beyond = place >= pieces[k]
        octant |= beyond << k  # octant first, as tokens of HOCT
        box = box * pieces[k] + place - (pieces[k] if beyond else 0)
    of_box = octant * pieces[0] * pieces[1] * pieces[2] + box
    key: int = first + (of_box * DIRECTIONS + table.direction[triangle]) * SIDES + back
    return key


@compiled
def keys_each(
    start: int,
    stop: int,
    table: CellTable,
    triangle: Int[np.ndarray, " r"],
    points: Float[np.ndarray, "r 3"],
    back: Bool[np.ndarray, " r"],
    keys: Int[np.ndarray, " r"],
) -> None:
    """Fill in the keys of points; see `key_at`."""
    for row in range(start, stop):
        keys[row] = key_at(table, triangle[row], triple(points[row]), back[row])

"""Which cell a point of a triangle belongs to: keys of cells, and the sorted table of those there are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer.compiled import compiled, int64
from rfpp.gbuffer.vectors import Vector, dot, triple

#: What a ray's end is called that meets no cell.
NOWHERE = -1
#: Half an object is cut into so many pieces along an axis at most.
MOST_PIECES = 4
#: An object that reaches less far along an axis than this share of its greatest reach is flat.
FLAT = 1e-4
#: Directions of a triangle in its object's axes: forwards or backwards along one of three; and its two sides.
DIRECTIONS, SIDES = 6, 2
#: Keys of an octant.
KEYS_OF_OCTANT = (2 * MOST_PIECES) ** 3 * DIRECTIONS * SIDES


class CellTable(NamedTuple):
    """What loops read of a `CellMap`.

    Attributes:
        owner, direction: [M] object of each triangle, and which way it faces in the object's axes.
        centroid, axes, half, pieces: see `CellGrid`.
        keys, cell: ascending, and the cell of each; NOWHERE for those that no light can reach.
        coarse_keys, coarse_cell: of every octant's side, its first.
    """

    owner: Int[np.ndarray, " m"]
    direction: Int[np.ndarray, " m"]
    centroid: Float[np.ndarray, "o 3"]
    axes: Float[np.ndarray, "o 3 3"]
    half: Float[np.ndarray, "o 3"]
    pieces: Int[np.ndarray, "o 3"]
    keys: Int[np.ndarray, " k"]
    cell: Int[np.ndarray, " k"]
    coarse_keys: Int[np.ndarray, " j"]
    coarse_cell: Int[np.ndarray, " j"]


@compiled
def key_at(table: CellTable, triangle: int, point: Vector, back: bool) -> int:
    """A number for the cell of a point on the front or the back of a triangle; the same for the same cell."""
    owner = table.owner[triangle]
    half, pieces, centre = table.half[owner], table.pieces[owner], table.centroid[owner]
    flat = FLAT * max(half[0], half[1], half[2])
    away = (point[0] - centre[0], point[1] - centre[1], point[2] - centre[2])
    octant, box = 0, 0
    for k in range(3):
        place = pieces[k]
        if half[k] >= flat:  # else rounding alone would say on which side a point lies
            place += int64(np.floor(dot(table.axes[owner, k], away) / max(half[k], 1e-9) * pieces[k]))
        place = min(max(place, 0), 2 * pieces[k] - 1)
        octant |= (place >= pieces[k]) << k  # octant first: it is what a token of HOCT stands for
        box = box * 2 * MOST_PIECES + place
    of_box = (owner * 8 + octant) * (2 * MOST_PIECES) ** 3 + box
    key: int = (of_box * DIRECTIONS + table.direction[triangle]) * SIDES + back
    return key


@compiled
def coarse_key(key: int) -> int:
    """A number for octant and side alone."""
    return key // KEYS_OF_OCTANT * SIDES + key % SIDES


@compiled
def cell_of(table: CellTable, key: int) -> int:
    """The cell of a key. Cells so small that none of our points lay there: any of their octant and side."""
    row = _found(table.keys, key)
    if row >= 0:
        cell: int = table.cell[row]
        return cell
    row = _found(table.coarse_keys, coarse_key(key))
    if row < 0:
        return NOWHERE
    coarse: int = table.coarse_cell[row]
    return coarse


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
    """Keys of points."""
    for row in range(start, stop):
        keys[row] = key_at(table, triangle[row], triple(points[row]), back[row])


@compiled
def cells_each(
    start: int, stop: int, table: CellTable, keys: Int[np.ndarray, " r"], cell: Int[np.ndarray, " r"]
) -> None:
    """Cells of keys."""
    for row in range(start, stop):
        cell[row] = cell_of(table, keys[row])


@compiled
def _found(keys: Int[np.ndarray, " k"], key: int) -> int:
    """Where a key stands among ascending ones; -1 for nowhere."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else -1

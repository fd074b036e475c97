"""Split cells that a wall divides, so that no light passes through it within a cell."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.radiosity.cell_table import NOWHERE
from rfpp.raycast.raycast import RayCaster
from rfpp.scene.triangles import SceneTriangles

#: Points of a cell that are tested for mutual visibility, height above the surface, and rounds of splitting.
_TESTED, _HEIGHT, _ROUNDS = 8, 1e-3, 2
#: A divider stands on the surface (cosine between normals below this) and hides this share of the pairs across it.
_UPRIGHT, _HIDDEN = 0.5, 0.9
#: Dividers tried for each cell.
_TRIED = 6

_PAIRS = np.array(list(combinations(range(_TESTED), 2)))


@dataclass(frozen=True, eq=False)
class CellSplits:
    """Binary tree of planes that divide cells.

    Attributes:
        plane: [S, 4] unit normal and offset of each plane.
        child: [S, 2] cell behind and in front of it; below NOWHERE another split, see `as_split`.
    """

    plane: Float[np.ndarray, "s 4"]
    child: Int[np.ndarray, "s 2"]

    def renumbered(self, numbers: Int[np.ndarray, " c_plus_1"]) -> CellSplits:
        """Return the same planes with new numbers of cells; the last number is that of NOWHERE."""
        return CellSplits(self.plane, np.where(self.child >= NOWHERE, numbers[self.child], self.child))


#: No cell is divided.
NO_SPLITS = CellSplits(np.zeros((0, 4)), np.zeros((0, 2), np.int64))


def as_split(number: int | np.ndarray) -> int | np.ndarray:
    """Encode a split as a number of a cell."""
    return NOWHERE - 1 - number


def split_cells(
    triangles: SceneTriangles,
    caster: RayCaster,
    position: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    cell: Int[np.ndarray, " r"],
    tested: Int[np.ndarray, " t"],
) -> tuple[Int[np.ndarray, " c"], CellSplits, Int[np.ndarray, " r"]]:
    """Split cells at the walls that stand on them.

    Args:
        position: Points of the cells, at least one of each.
        tested: Cells that may be split.

    Returns:
        The number that replaces each cell (itself, or a split), the splits, and the cell of each point.
    """
    count, cell = int(cell.max()) + 1, cell.copy()
    entry = np.arange(count)
    planes: list[np.ndarray] = []
    children: list[list[int]] = []
    parent = {number: ("entry", number, 0) for number in range(count)}
    for _ in range(_ROUNDS):
        divided = []
        for number, plane, in_front in _dividers(triangles, caster, position, normal, cell, tested):
            split = len(planes)
            planes.append(plane)
            children.append([number, count])
            kind, place, side = parent[number]
            if kind == "entry":
                entry[place] = as_split(split)
            else:
                children[place][side] = int(as_split(split))
            parent[number], parent[count] = ("child", split, 0), ("child", split, 1)
            rows = np.flatnonzero(cell == number)
            cell[rows[in_front]] = count
            divided += [number, count]
            count += 1
        tested = np.array(divided, np.int64)
        if not divided:
            break
    tree = CellSplits(np.array(planes, np.float64).reshape(-1, 4), np.array(children, np.int64).reshape(-1, 2))
    return entry, tree, cell


def _dividers(
    triangles: SceneTriangles,
    caster: RayCaster,
    position: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    cell: Int[np.ndarray, " r"],
    tested: Int[np.ndarray, " t"],
) -> list[tuple[int, Float[np.ndarray, " 4"], Bool[np.ndarray, " p"]]]:
    """Return (cell, plane, mask of points in front) for each tested cell that a wall divides."""
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], tested)
    size = np.searchsorted(cell[order], tested, side="right") - first
    tested, first, size = tested[size > 1], first[size > 1], size[size > 1]
    if not len(tested):
        return []
    chosen = order[first[:, None] + np.arange(_TESTED) * size[:, None] // _TESTED]  # [t, _TESTED]
    raised = position[chosen] + _HEIGHT * normal[chosen]
    start, end = raised[:, _PAIRS[:, 0]], raised[:, _PAIRS[:, 1]]
    apart = np.linalg.norm(end - start, axis=-1)
    direction = (end - start) / np.maximum(apart, 1e-9)[..., None]
    hit = caster.cast(start.reshape(-1, 3), direction.reshape(-1, 3))
    triangle = hit.triangle.reshape(apart.shape)
    corners = triangles.positions[triangle.clip(0)].astype(np.float64)
    across = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-30)
    upright = np.abs((across * normal[chosen[:, :1]]).sum(-1)) < _UPRIGHT
    hidden = (triangle >= 0) & (hit.distance.reshape(apart.shape) < apart) & (apart > 1e-6) & upright
    found = []
    for row in np.flatnonzero(hidden.any(1)):
        blocked = np.flatnonzero(hidden[row])
        best, score = None, 0
        for pair in blocked[:: max(1, len(blocked) // _TRIED)]:
            plane = np.append(across[row, pair], across[row, pair] @ corners[row, pair, 0])
            in_front = raised[row] @ plane[:3] > plane[3]
            over = in_front[_PAIRS[:, 0]] != in_front[_PAIRS[:, 1]]
            if over.any() and hidden[row, over].mean() >= _HIDDEN and over.sum() > score:
                best, score = plane, int(over.sum())
        if best is not None:
            members = np.sort(order[first[row] : first[row] + size[row]])
            in_front = position[members] @ best[:3] > best[3]
            if 0 < in_front.sum() < len(members):
                found.append((int(tested[row]), best, in_front))
    return found

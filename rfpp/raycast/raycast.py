"""Triangles and rays to hits. Only this and `embree` know the ray-tracing library."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rfpp.raycast.compiled import compiled
from rfpp.raycast.embree import Structure, closest, embree
from rfpp.raycast.threads import over_rows


class Hits(NamedTuple):
    """The nearest hit of each of R rays; where there is none, -1, zeros and infinity.

    Attributes:
        triangle: [R] int32 index of the triangle, -1 for none.
        barycentric: [R, 3] float32 weights of the triangle's corners 0, 1, 2.
        distance: [R] float32 along the ray, in lengths of its direction.
    """

    triangle: Int[np.ndarray, " r"]
    barycentric: Float[np.ndarray, "r 3"]
    distance: Float[np.ndarray, " r"]


class RayCaster:
    """An acceleration structure over triangles, possibly none at all; built once, cast many times.

    Args:
        positions: [M, 3, 3] float32 corners.

    Raises:
        MissingDependencyError: Embree is not installed.

    Attributes:
        address: of the structure, for compiled loops (`rfpp.raycast.embree`); 0 for no triangles.
    """

    def __init__(self, positions: Float[np.ndarray, "m 3 3"]) -> None:
        embree()  # compiled loops name its functions
        self._count = len(positions)
        self._structure = Structure(positions) if self._count else None
        self.address = self._structure.address if self._structure else 0

    def __len__(self) -> int:
        """Return the number of triangles."""
        return self._count

    def cast(self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"]) -> Hits:
        """Return the closest triangle hit by each ray, from either side."""
        count = len(origins)
        hits = Hits(np.empty(count, np.int32), np.empty((count, 3), np.float32), np.empty(count, np.float32))
        over_rows(count, _cast, self.address, _packed(origins), _packed(directions), *hits)
        return hits


def _packed(vectors: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(vectors, dtype=np.float32)


@compiled
def _cast(
    first: int,
    last: int,
    address: int,
    origins: Float[np.ndarray, "r 3"],
    directions: Float[np.ndarray, "r 3"],
    triangle: Int[np.ndarray, " r"],
    barycentric: Float[np.ndarray, "r 3"],
    distance: Float[np.ndarray, " r"],
) -> None:
    for row in range(first, last):
        hit, u, v, reach = closest(address, origins[row], directions[row])
        triangle[row], distance[row] = hit, reach
        barycentric[row, 0], barycentric[row, 1], barycentric[row, 2] = (1 - u - v if hit >= 0 else 0.0), u, v

"""Texels: materials that vary within triangles. Cameras see them; networks take one material per triangle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from jaxtyping import Bool, Float, Int

#: Columns of `Texels.values` besides those of `SceneTriangles.material`.
NORMAL = slice(7, 10)


@dataclass(frozen=True, eq=False)
class Texels:
    """Materials of the similar parts of triangles: each triangle is divided into four, each part again, and so on.

    A triangle of level n has 4 rows for its first division, 16 for its second, … 4ⁿ for its last; coarse rows are means
    of finer ones. The digits of a part's number to the base 4 are its places in each division, the first division in
    the lowest digit: 0, 1, 2 at a corner, 3 in the middle (`rfpp.scene.io.pieces.Pieces.quartered`).

    Attributes:
        level: [M] number of divisions; 0 for triangles of one material.
        first: [M] first row.
        values: [T, 10] float32: diffuse 3, specular 3, roughness 1, shading normal 3. The normal is relative to a frame
            whose z axis is the interpolated normal, and whose x axis runs from corner 0 to corner 1.
    """

    level: Int[np.ndarray, " m"]
    first: Int[np.ndarray, " m"]
    values: Float[np.ndarray, "t 10"]

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.level)

    @classmethod
    def none(cls, count: int) -> Texels:
        """Return texels of triangles of one material each."""
        return cls(np.zeros(count, np.int8), np.zeros(count, np.int64), np.empty((0, 10), np.float32))

    @classmethod
    def of_all(cls, parts: Sequence[tuple[Texels | None, int]]) -> Texels | None:
        """Return the texels of several meshes, given each one's, or None, and its number of triangles."""
        if all(texels is None for texels, _ in parts):
            return None
        every = [cls.none(count) if texels is None else texels for texels, count in parts]
        starts = np.cumsum([0, *(len(texels.values) for texels in every[:-1])])
        return cls(
            np.concatenate([texels.level for texels in every]),
            np.concatenate([texels.first + start for texels, start in zip(every, starts, strict=True)]),
            np.concatenate([texels.values for texels in every]),
        )

    def only(self, triangles: Bool[np.ndarray, " m"] | Int[np.ndarray, " n"]) -> Texels:
        """Return the texels of some triangles (mask or indices)."""
        level, counts = self.level[triangles], rows_of(self.level[triangles])
        first = np.cumsum(counts) - counts
        rows = np.repeat(self.first[triangles] - first, counts) + np.arange(counts.sum())
        return Texels(level, first, self.values[rows])

    @cached_property
    def digest(self) -> bytes:
        """Hash of the content, computed once."""
        content = sha256(np.ascontiguousarray(self.level).tobytes())
        content.update(np.ascontiguousarray(self.values).tobytes())
        return content.digest()


def rows_of(level: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Return the number of rows of triangles of a level: 4 + 16 + … + 4ⁿ."""
    return (4 ** (level.astype(np.int64) + 1) - 4) // 3

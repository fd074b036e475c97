"""Parts of faces, and what textured surfaces say about them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class Pieces:
    """Parts of the faces of a mesh.

    Attributes:
        face: [N] their faces.
        weights: [N, 3, 3] barycentric coordinates of their corners in these.
        positions: [N, 3, 3] positions of their corners.
    """

    face: Int[np.ndarray, " n"]
    weights: Float[np.ndarray, "n 3 3"]
    positions: Float[np.ndarray, "n 3 3"]

    @classmethod
    def whole(cls, corners: Float[np.ndarray, "f 3 3"]) -> Pieces:
        """Return each face as one piece."""
        return cls(np.arange(len(corners)), np.broadcast_to(np.eye(3), (len(corners), 3, 3)), corners)

    def __len__(self) -> int:
        return len(self.face)

    @property
    def areas(self) -> Float[np.ndarray, " n"]:
        a, b, c = np.moveaxis(self.positions, 1, 0)
        return np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2

    def of(self, corners: Float[np.ndarray, "f 3 c"]) -> Float[np.ndarray, "n 3 c"]:
        """Interpolate values at the corners of the faces."""
        return self.weights @ corners[self.face]

    def only(self, chosen: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> Pieces:
        """Return some pieces (mask or indices)."""
        return Pieces(self.face[chosen], self.weights[chosen], self.positions[chosen])

    def joined(self, others: Pieces) -> Pieces:
        """Return the pieces and others behind them."""
        pairs = ((getattr(self, name), getattr(others, name)) for name in ("face", "weights", "positions"))
        return Pieces(*map(np.concatenate, pairs))

    def quartered(self) -> Pieces:
        """Return four pieces for each."""
        return Pieces(np.tile(self.face, 4), _quarters(self.weights), _quarters(self.positions))


def _quarters(corners: Float[np.ndarray, "n 3 c"]) -> Float[np.ndarray, "m 3 c"]:
    """Return the four similar parts of triangles; neighbors have the same midpoints, bit by bit."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(part, 1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


@runtime_checkable
class Surface(Protocol):
    """A material with textures, on a mesh."""

    def rows(self, pieces: Pieces) -> tuple[Float[np.ndarray, "n 10"], Bool[np.ndarray, " n"]]:
        """Return the mean material of each piece, and a mask of pieces that are not cut out."""

    def spread(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        """Return the standard deviation of the textures within each piece."""

    def pixels_along(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        """Return the pixels of the finest texture along each piece; 0 where no texture varies."""

    def normals(self, pieces: Pieces) -> Float[np.ndarray, "n 3"] | None:
        """Return the mean of the normal map within each piece, in its tangent space; None without a map."""

    def coordinates(self, pieces: Pieces) -> Float[np.ndarray, "n 3 2"] | None:
        """Return the normal map's coordinates at the corners of each piece."""

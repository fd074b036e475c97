"""Subdivide triangles where their textures vary, because a triangle has one material.

The triangles whose textures differ most from their mean, weighted by area, are divided into four until they look alike
or a budget is spent. A smooth surface is divided as a whole: where a divided triangle met an undivided one, the
shading would have a crease.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.scene.io.imported_scene import Part

#: Default number of triangles that textures may add to a file.
TEXTURE_TRIANGLES = 20_000
#: Standard deviation of a texture within a triangle that is not seen.
_ALIKE = 0.04
#: In each round, triangles with at least this share of the largest error are divided.
_SHARE = 0.25
#: Share of the area of all `TexturedPart`s below which an error does not count.
_SMALL = 1e-5


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

    def only(self, chosen: Bool[np.ndarray, " n"]) -> Pieces:
        """Return the chosen pieces."""
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


@dataclass(frozen=True, eq=False)
class TexturedPart:
    """A part in the process of subdivision.

    Attributes:
        part: the part before; its material is not used.
        spread: [N] `Surface.spread` of the pieces.
    """

    part: Part
    surface: Surface
    pieces: Pieces
    spread: Float[np.ndarray, " n"]

    @classmethod
    def whole(cls, part: Part, surface: Surface) -> TexturedPart:
        """Return an undivided part."""
        pieces = Pieces.whole(part.corners)
        return cls(part, surface, pieces, surface.spread(pieces))

    def errors(self, room: int) -> Float[np.ndarray, " n"]:
        """Return the error of each piece; zero if it is not seen, or if only so many pieces may be divided."""
        errors = np.where(self.spread > _ALIKE, self.spread * self.pieces.areas, 0)
        if not self.part.smooth:
            return errors
        return np.full_like(errors, errors.mean() if 0 < len(errors) <= room else 0)

    def divided(self, chosen: Bool[np.ndarray, " n"]) -> TexturedPart:
        """Return the part with each chosen piece replaced by four."""
        added = self.pieces.only(chosen).quartered()
        pieces = self.pieces.only(~chosen).joined(added)
        return replace(self, pieces=pieces, spread=np.concatenate([self.spread[~chosen], self.surface.spread(added)]))

    def finished(self) -> Part:
        """Return the part with its materials, without what is cut out."""
        rows, present = self.surface.rows(self.pieces)
        if len(self.pieces) == len(self.part):
            return replace(self.part, material=rows).only(present)
        vertices, faces = self.pieces.positions.reshape(-1, 3), np.arange(3 * len(rows)).reshape(-1, 3)
        return replace(self.part, vertices=vertices, faces=faces, material=rows).only(present)


def detail_notice(textures: int, added: int) -> str:
    """Return what became of a file's textures."""
    if not added:
        return f"textures are averaged over each triangle ({textures})"
    return f"textures became colors of triangles ({textures}), for which {added:,} triangles were added"


def with_detail(parts: Sequence[Part | TexturedPart], detail: int, most: int | None = None) -> tuple[list[Part], int]:
    """Return finished parts, and the number of added triangles.

    Args:
        detail: Triangles that may be added.
        most: Triangles that the parts may have in all, if none are left out; None: any number.
    """
    total = sum(len(part.part if isinstance(part, TexturedPart) else part) for part in parts)
    at_first = room = max(0, detail if most is None else min(detail, most - total)) // 3
    result = list(parts)
    textured = [index for index, part in enumerate(parts) if isinstance(part, TexturedPart)]
    varied = [index for index in textured if (parts[index].spread > _ALIKE).any()]
    area = sum(parts[index].pieces.areas.sum() for index in textured) if varied else 0
    while varied and room:
        errors = {index: result[index].errors(room) for index in varied}
        largest = max((each.max(initial=0) for each in errors.values()), default=0)
        if not largest > _SMALL * area:
            break
        for index in sorted(varied, key=lambda index: -errors[index].max(initial=0)):
            chosen = errors[index] >= _SHARE * largest
            if chosen.sum() > room:
                if result[index].part.smooth:
                    continue
                chosen[np.argsort(-errors[index], kind="stable")[room:]] = False
            if chosen.any():
                result[index] = result[index].divided(chosen)
                room -= int(chosen.sum())
    finished = [part.finished() if isinstance(part, TexturedPart) else part for part in result]
    return finished, 3 * (at_first - room)

"""Subdivide triangles where their textures vary, because networks take one material per triangle.

The triangles whose textures differ most from their mean, weighted by area, are divided into four until they look alike
or a budget is spent. A smooth surface is divided as a whole: where a divided triangle met an undivided one, the
shading would have a crease.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.scene.io.imported_scene import Part
from rfpp.scene.io.pieces import Pieces, Surface
from rfpp.scene.io.texture_baking import MOST_TEXELS, baked, levels_of

#: Default number of triangles that textures may add to a file.
TEXTURE_TRIANGLES = 20_000
#: Standard deviation of a texture within a triangle that is not seen.
_ALIKE = 0.04
#: In each round, triangles with at least this share of the largest error are divided.
_SHARE = 0.25
#: Share of the area of all `TexturedPart`s below which an error does not count.
_SMALL = 1e-5


@dataclass(frozen=True, eq=False)
class TexturedPart:
    """A part in the process of subdivision.

    Attributes:
        part: part before subdivision; its material is not used.
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

    def finished(self, levels: Int[np.ndarray, " n"]) -> Part:
        """Return the part with its materials and texels, without cut-out pieces.

        Args:
            levels: Divisions of each piece into texels.
        """
        rows, present = self.surface.rows(self.pieces)
        vertices, faces = self.part.vertices, self.part.faces
        if len(self.pieces) > len(self.part):
            vertices, faces = self.pieces.positions.reshape(-1, 3), np.arange(3 * len(rows)).reshape(-1, 3)
        texels = baked(self.surface, self.pieces, levels) if levels.any() else None
        return replace(self.part, vertices=vertices, faces=faces, material=rows, texels=texels).only(present)


def detail_notice(textures: int, added: int) -> str:
    """Return what became of a file's textures."""
    divided = f", for which {added:,} triangles were added" if added else ""
    return f"textures ({textures}) are seen as they are; light and networks take one color per triangle{divided}"


def with_detail(
    parts: Sequence[Part | TexturedPart], detail: int, most: int | None = None, texels: int = MOST_TEXELS
) -> tuple[list[Part], int]:
    """Return finished parts, and the number of added triangles.

    Args:
        detail: Triangles that may be added.
        most: Triangles that the parts may have in all, if none are omitted; None: any number.
        texels: Finest texels that they may have.
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
    levels = levels_of([(result[index].surface, result[index].pieces) for index in textured], texels)
    for index, own in zip(textured, levels, strict=True):
        result[index] = result[index].finished(own)
    return result, 3 * (at_first - room)

"""Bake textures into texels, which keep detail that is finer than triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from rfpp.scene.io.pieces import Pieces, Surface
from rfpp.scene.texels import NORMAL, Texels, rows_of

#: Default limit of the finest parts of all triangles of a file: 56 MB with the coarser ones.
MOST_TEXELS = 1 << 20
#: Divisions of one triangle; `image_texture` keeps pictures of 2¹⁰ pixels.
_MOST_DIVISIONS = 10
#: Parts that are computed at a time.
_CHUNK = 1 << 17


def levels_of(textured: Sequence[tuple[Surface, Pieces]], most: int) -> list[Int[np.ndarray, " n"]]:
    """Return how often each surface's pieces are divided: until a part is as large as a pixel of its textures.

    Args:
        most: Limit of all parts; if more are needed, the largest ones of all surfaces have about the same size.
    """
    wanted, sides = [], []
    for surface, own in textured:
        pixels = np.maximum(np.nan_to_num(surface.pixels_along(own)), 1.0)
        wanted.append(np.minimum(np.ceil(np.log2(pixels) - 1e-6), _MOST_DIVISIONS).astype(np.int64))
        sides.append(np.maximum(np.sqrt(own.areas), 1e-30))
    if not wanted:
        return []
    every, side = np.concatenate(wanted), np.concatenate(sides)
    levels, smallest = every, float((side / 2.0**every).min())
    while (4**levels)[levels > 0].sum() > most:
        smallest *= 1.1
        levels = np.minimum(every, np.maximum(np.ceil(np.log2(side / smallest)), 0).astype(np.int64))
    return np.split(levels, np.cumsum([len(own) for own in wanted])[:-1])


def baked(surface: Surface, pieces: Pieces, levels: Int[np.ndarray, " n"]) -> Texels:
    """Return the texels of pieces that are divided so many times."""
    counts = rows_of(levels)
    first = np.cumsum(counts) - counts
    values = np.empty((counts.sum(), 10), np.float32)
    for level in np.unique(levels[levels > 0]).tolist():
        chosen = np.flatnonzero(levels == level)
        for some in np.array_split(chosen, -(-len(chosen) * 4**level // _CHUNK)):
            if not len(some):
                continue
            rows = _rows(surface, pieces.only(some), level)
            values[first[some][:, None] + np.arange(rows.shape[1])] = rows
    return Texels(levels.astype(np.int8), first, values)


def _rows(surface: Surface, pieces: Pieces, level: int) -> Float[np.ndarray, "n rows 10"]:
    parts = pieces
    for _ in range(level):
        parts = parts.quartered()
    finest = np.zeros((len(parts), 10), np.float32)
    finest[:, :7] = surface.rows(parts)[0][:, :7]
    finest[:, NORMAL] = _in_plane(surface.normals(parts), surface.coordinates(pieces), pieces)
    every = [finest.reshape(-1, len(pieces), 10)]
    for _ in range(level - 1):
        every.append(every[-1].reshape(4, -1, len(pieces), 10).mean(axis=0))
    return np.concatenate(every[::-1]).swapaxes(0, 1)


def _in_plane(
    normals: Float[np.ndarray, "m 3"] | None, uv: Float[np.ndarray, "n 3 2"] | None, pieces: Pieces
) -> Float[np.ndarray, "m 3"] | tuple[float, float, float]:
    """Return tangent-space normals in frames whose x axis runs from corner 0 to corner 1 of the pieces."""
    if normals is None or uv is None:
        return 0.0, 0.0, 1.0
    a, b, c = np.moveaxis(pieces.positions, 1, 0)
    along, across = b - a, c - a
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-30)
    right = (along * across).sum(1) / length
    up = np.sqrt(np.maximum((across * across).sum(1) - right**2, 1e-30))
    (du_b, dv_b), (du_c, dv_c) = np.moveaxis(uv[:, 1:] - uv[:, :1], (1, 2), (0, 1))
    # the directions in which u grows and v falls (a picture's first row is at v = 0), times their common determinant
    mirrored = np.sign(du_b * dv_c - du_c * dv_b)
    tangent = np.stack([dv_c * length - dv_b * right, -dv_b * up], axis=1) * mirrored[:, None]
    upwards = -np.stack([du_b * right - du_c * length, du_b * up], axis=1) * mirrored[:, None]
    tangent, upwards = (axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-30)
                        for axis in (tangent, upwards))  # fmt: skip
    x, y, z = normals.reshape(-1, len(pieces), 3).transpose(2, 0, 1)
    turned = x[..., None] * tangent + y[..., None] * upwards
    return np.concatenate([turned, z[..., None]], axis=-1).reshape(-1, 3)

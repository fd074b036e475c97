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
#: Steps in which the size of parts is found, within 100 powers of two at most.
_BISECTIONS = 14
#: Parts that are computed at a time.
_CHUNK = 1 << 17


def levels_of(textured: Sequence[tuple[Surface, Pieces]], most: int) -> list[Int[np.ndarray, " n"]]:
    """Return how often each surface's pieces are divided: until a part is as large as a pixel of its textures.

    Args:
        most: Limit of all parts; if more are needed, the largest ones of all surfaces have about the same size.
    """
    levels = []
    for surface, pieces in textured:
        pixels = np.maximum(np.nan_to_num(surface.pixels_along(pieces)), 1.0)
        levels.append(np.minimum(np.ceil(np.log2(pixels) - 1e-6), _MOST_DIVISIONS).astype(np.int64))
    varied = [number for number, level in enumerate(levels) if level.any()]
    if not varied:
        return levels
    wanted = np.concatenate([levels[number] for number in varied])
    side = np.maximum(np.sqrt(np.concatenate([textured[number][1].areas for number in varied])), 1e-30)
    fitting = _fitting(wanted, side, most)
    ends = np.cumsum([len(levels[number]) for number in varied])
    for number, own in zip(varied, np.split(fitting, ends[:-1]), strict=True):
        levels[number] = own
    return levels


def _fitting(wanted: Int[np.ndarray, " n"], side: Float[np.ndarray, " n"], most: int) -> Int[np.ndarray, " n"]:
    """Return at most the wanted divisions of pieces of some size, so that their parts are no more than `most`."""

    def of(size: float) -> Int[np.ndarray, " n"]:
        return np.minimum(wanted, np.maximum(np.ceil(np.log2(side) - size), 0).astype(np.int64))

    too_small, fits = float((np.log2(side) - wanted).min()), float(np.log2(side).max())  # log₂ of sizes of parts
    if (4**wanted)[wanted > 0].sum() <= most:
        return wanted
    for _ in range(_BISECTIONS):
        middle = (too_small + fits) / 2
        levels = of(middle)
        too_small, fits = (too_small, middle) if (4**levels)[levels > 0].sum() <= most else (middle, fits)
    return of(fits)


def baked(surface: Surface, pieces: Pieces, levels: Int[np.ndarray, " n"]) -> Texels:
    """Return the texels of pieces that are divided `levels` times."""
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
    x, y, z = normals.reshape(-1, len(pieces), 3).transpose(2, 0, 1)
    turned = x[..., None] * _unit(tangent) + y[..., None] * _unit(upwards)
    return np.concatenate([turned, z[..., None]], axis=-1).reshape(-1, 3)


def _unit(vectors: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)

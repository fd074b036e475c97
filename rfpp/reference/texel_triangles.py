"""Texels as triangles, because Blender's meshes take one material per triangle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from rfpp.scene.io.pieces import Pieces
from rfpp.scene.texels import NORMAL, Texels
from rfpp.scene.triangles import EMISSION, SceneTriangles


def divided(triangles: SceneTriangles) -> SceneTriangles:
    """Return the scene with a triangle for each of the finest texels, and no texels."""
    if (texels := triangles.texels) is None:
        return triangles
    counts = 4 ** texels.level.astype(np.int64)
    first = np.cumsum(counts) - counts
    positions, normals = (np.empty((counts.sum(), 3, 3), np.float32) for _ in range(2))
    material = np.empty((counts.sum(), triangles.material.shape[1]), np.float32)
    for level in np.unique(texels.level).tolist():
        chosen = np.flatnonzero(texels.level == level)
        for some in np.array_split(chosen, -(-len(chosen) * 4**level // (1 << 17))):
            rows = first[some][:, None] + np.arange(4**level)
            weights = _weights(level)
            positions[rows] = weights @ triangles.positions[some][:, None]
            normals[rows] = weights @ triangles.normals[some][:, None]
            material[rows] = triangles.material[some][:, None]
            if level:
                _add_texels(triangles, texels, some, level, rows, normals, material)
    a, b, c = np.moveaxis(positions, 1, 0)
    solid = (np.cross(b - a, c - a) != 0).any(axis=1)  # the finest may be smaller than float32 can tell apart
    kept = np.concatenate([[0], np.cumsum(solid)])
    return replace(
        triangles,
        positions=positions[solid],
        normals=normals[solid],
        material=material[solid],
        object_offsets=kept[np.append(first, counts.sum())[triangles.object_offsets]].astype(np.int32),
        texels=None,
    )


def _weights(level: int) -> Float[np.ndarray, "n 3 3"]:
    whole = Pieces.whole(np.eye(3)[None])
    for _ in range(level):
        whole = whole.quartered()
    return whole.weights


def _add_texels(
    triangles: SceneTriangles,
    texels: Texels,
    some: np.ndarray,
    level: int,
    rows: np.ndarray,
    normals: Float[np.ndarray, "m 3 3"],
    material: Float[np.ndarray, "m 10"],
) -> None:
    """Change the rows of divided triangles of one level to their finest texels."""
    values = texels.values[texels.first[some][:, None] + (4**level - 4) // 3 + np.arange(4**level)]
    material[rows, : EMISSION.start] = values[..., : EMISSION.start]
    corners = triangles.positions[some].astype(np.float64)
    up = _unit(normals[rows])
    edge = (corners[:, 1] - corners[:, 0])[:, None, None]
    along = _unit(edge - up * (up * edge).sum(-1, keepdims=True))
    x, y, z = np.moveaxis(values[:, :, None, NORMAL, None], 3, 0)
    normals[rows] = _unit(x * along + y * np.cross(up, along) + z * up)


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)

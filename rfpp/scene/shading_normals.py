"""Shading normals of triangle meshes: flat, or smooth with creases."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rfpp.scene.mesh import Mesh, welded

#: Edges with a larger angle between their faces stay sharp in smooth shading.
CREASE_DEGREES = 30.0


def corner_normals(mesh: Mesh, smooth: bool, crease_degrees: float = CREASE_DEGREES) -> Float[np.ndarray, "faces 3 3"]:
    """Return unit shading normals of the corners of each face, float32.

    Flat: the face normal. Smooth: the angle-weighted mean over the faces around the vertex on the same side of all
    creases. Coincident positions count as one vertex. The mesh must have no degenerate faces.
    """
    normals = _face_normals(mesh)
    per_corner = np.repeat(normals, 3, axis=0)
    if smooth:
        first, second = _smooth_edges(mesh, normals, crease_degrees)
        fans = _components(
            np.concatenate([first, _next_corner(first)]), np.concatenate([_next_corner(second), second]), 3 * len(mesh)
        )
        weighted = per_corner * _corner_angles(mesh).reshape(-1, 1)
        sums = np.stack([np.bincount(fans, weights=column) for column in weighted.T], axis=1)
        per_corner = _unit(sums)[fans]
    return per_corner.reshape(-1, 3, 3).astype(np.float32)


def shading_groups(mesh: Mesh, smooth: bool, crease_degrees: float = CREASE_DEGREES) -> Int[np.ndarray, " faces"]:
    """Return the index of each face's smoothly shaded part, from 0 in the order of the faces.

    Without smooth shading, every face is its own part.
    """
    if not smooth:
        return np.arange(len(mesh), dtype=np.int32)
    first, second = _smooth_edges(mesh, _face_normals(mesh), crease_degrees)
    return _components(first // 3, second // 3, len(mesh))


def _smooth_edges(mesh: Mesh, normals: np.ndarray, crease_degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of half-edges of adjacent faces whose common edge is smooth.

    A half-edge is identified by its first corner, 3 * face + 0, 1 or 2. Edges of more than two faces, or of two
    inconsistently oriented faces, are sharp.
    """
    start = welded(mesh).faces.reshape(-1).astype(np.int64)
    end = start[_next_corner(np.arange(len(start)))]
    key = np.minimum(start, end) * (start.max() + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    begin = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(begin, append=len(order))
    pairs = begin[count == 2]
    first, second = order[pairs], order[pairs + 1]
    cosine = np.einsum("ec,ec->e", normals[first // 3], normals[second // 3])
    # the tolerance keeps an edge of exactly the crease angle smooth despite rounding
    is_smooth = (cosine > math.cos(math.radians(crease_degrees)) - 1e-6) & (start[first] == end[second])
    return first[is_smooth], second[is_smooth]


def _next_corner(corner: np.ndarray) -> np.ndarray:
    return corner - corner % 3 + (corner + 1) % 3


def _components(a: np.ndarray, b: np.ndarray, count: int) -> np.ndarray:
    """Label the connected components of the graph with edges a - b, [count]."""
    graph = coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def _face_normals(mesh: Mesh) -> np.ndarray:
    corners = mesh.corners.astype(np.float64)
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _corner_angles(mesh: Mesh) -> np.ndarray:
    """Return interior angles in radians, [F, 3]."""
    corners = mesh.corners.astype(np.float64)
    onward = _unit(np.roll(corners, -1, axis=1) - corners)
    backward = _unit(np.roll(corners, 1, axis=1) - corners)
    return np.arccos(np.clip(np.einsum("fkc,fkc->fk", onward, backward), -1, 1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    # twice as fast as np.linalg.norm
    return vectors / np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]

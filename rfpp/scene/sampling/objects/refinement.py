"""Refine meshes without changing the surface, by bisecting longest edges."""

from __future__ import annotations

import numpy as np

from rfpp.scene.mesh import Mesh


def refined(mesh: Mesh, target_faces: int) -> Mesh:
    """Refine a mesh to `target_faces` faces, or one less for a closed mesh; finer meshes are returned unchanged.

    Each round bisects the edges that are the longest edge of every adjacent face (Rivara 1984), longest first. Such
    edges share no face, so a round is vectorised; sharp features are kept and slivers do not get worse.
    """
    vertices, faces = mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64)
    while True:
        edges, face_edges, touching = _edges(faces)
        terminal = _terminal_edges(vertices, edges, face_edges, touching)
        # a split adds one face per adjacent face: keep the longest edges whose sum fits
        terminal = terminal[np.cumsum(touching[terminal]) <= target_faces - len(faces)]
        if len(terminal) == 0:
            return Mesh(vertices, faces)
        vertices, faces = _bisected(vertices, faces, edges, face_edges, terminal)


def is_closed(mesh: Mesh) -> bool:
    """Return whether every edge touches exactly two faces."""
    _, _, touching = _edges(mesh.faces.astype(np.int64))
    return bool((touching == 2).all())


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unique edges [E, 2], the edge opposite to each corner [F, 3], and the number of faces per edge [E]."""
    ends = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (faces.max() + 1) + ends[:, 1]
    _, first, inverse, touching = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    return ends[first], inverse.reshape(-1, 3), touching


def _terminal_edges(
    vertices: np.ndarray, edges: np.ndarray, face_edges: np.ndarray, touching: np.ndarray
) -> np.ndarray:
    """Return the edges that are the longest of every adjacent face, longest first, then by index."""
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    rank = np.empty(len(edges), dtype=np.int64)
    rank[np.lexsort((np.arange(len(edges)), lengths))] = np.arange(len(edges))
    longest = np.take_along_axis(face_edges, rank[face_edges].argmax(axis=1)[:, None], axis=1)[:, 0]
    terminal = np.flatnonzero(np.bincount(longest, minlength=len(edges)) == touching)
    return terminal[np.argsort(-rank[terminal])]


def _bisected(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, face_edges: np.ndarray, split: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Split the given edges, no two of which share a face, at their midpoints."""
    middle = np.full(len(edges), -1)
    middle[split] = len(vertices) + np.arange(len(split))
    new_vertices = vertices[edges[split]].mean(axis=1)
    middle_at_corner = middle[face_edges]
    face, corner = np.nonzero(middle_at_corner >= 0)
    apex, left, right = (faces[face, (corner + k) % 3] for k in range(3))
    center = middle_at_corner[face, corner]
    halves = np.concatenate([np.stack([apex, left, center], axis=1), np.stack([apex, center, right], axis=1)])
    return np.concatenate([vertices, new_vertices]), np.concatenate([np.delete(faces, face, axis=0), halves])

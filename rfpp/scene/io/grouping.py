"""Divide files into objects: by parts and connected components, with a limit."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.io.imported_scene import Part
from rfpp.scene.mesh import same_positions
from rfpp.scene.texels import Texels

#: Maximum number of objects of training scenes.
MAX_OBJECTS = 70
#: Limit of loose pieces, as in a scan with fragments; more are unconnected triangles.
_MAX_PIECES = 1_000_000


def components(part: Part) -> Iterator[Part]:
    """Yield the connected pieces of a part in the order of their first faces; equal positions are one vertex.

    Raises:
        SceneError: If there are too many pieces.
    """
    if not len(part):
        return
    corners = same_positions(part.vertices)[1][part.faces]
    edges = (np.concatenate([corners[:, 0], corners[:, 0]]), np.concatenate([corners[:, 1], corners[:, 2]]))
    graph = coo_array((np.ones(len(edges[0]), bool), edges), shape=(corners.max() + 1,) * 2)
    label = connected_components(graph, directed=False)[1][corners[:, 0]]
    _, first, piece, count = np.unique(label, return_index=True, return_inverse=True, return_counts=True)
    if len(first) > _MAX_PIECES:
        raise SceneError(
            f"{len(first):,} loose pieces are more than {_MAX_PIECES:,}: join its triangles in the original program"
        )
    if len(first) == 1:
        yield part
        return
    piece = piece.reshape(-1)
    if len(first) > MAX_OBJECTS:  # fragments join the nearest large piece
        areas = np.bincount(piece, weights=part.areas)
        largest = np.argsort(-areas, kind="stable")[:MAX_OBJECTS]
        fragments = np.setdiff1d(np.arange(len(first)), largest)
        centers = _centers(part, piece, len(first))
        body = np.empty(len(first), np.int64)
        body[largest] = np.arange(len(largest))
        body[fragments] = cKDTree(centers[largest]).query(centers[fragments])[1]
        first, piece = first[largest], body[piece]
        count = np.bincount(piece)
    by_piece = np.split(np.argsort(piece, kind="stable"), np.cumsum(count)[:-1])
    for index in np.argsort(first):
        yield part.only(by_piece[index])


def merged(parts: Sequence[Part], path: Path) -> list[Part]:
    """Return at most `MAX_OBJECTS` surfaces and lights each, with unique names; small parts join the nearest large one.

    Warns if parts were joined.
    """
    kept = [*_merged([p for p in parts if not p.is_light]), *_merged([p for p in parts if p.is_light])]
    if len(kept) < len(parts):
        warnings.warn(f"{path}: {len(parts)} parts became {len(kept)} objects: small ones were joined to others",
                      stacklevel=4)  # fmt: skip
    return [replace(part, name=name) for part, name in zip(kept, _unique([p.name for p in kept]), strict=True)]


def _merged(parts: list[Part]) -> list[Part]:
    if len(parts) <= MAX_OBJECTS:
        return parts
    order = np.argsort([-part.areas.sum() for part in parts], kind="stable")
    large, small = np.sort(order[:MAX_OBJECTS]), order[MAX_OBJECTS:]
    centers = np.stack([part.corners.mean(axis=(0, 1)) for part in parts])
    nearest = cKDTree(centers[large]).query(centers[small])[1]
    joining = {index: [index] for index in large}
    for index, body in zip(small, large[nearest], strict=True):
        joining[body].append(index)
    return [joined([parts[index] for index in indices]) for indices in joining.values()]


def joined(parts: Sequence[Part]) -> Part:
    """Return the parts as one, with the name and the shading of the first."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        material=np.concatenate([part.material for part in parts]),
        one_sided=all(part.one_sided for part in parts),
        texels=Texels.of_all([(part.texels, len(part)) for part in parts]),
    )


def _centers(part: Part, piece: np.ndarray, count: int) -> np.ndarray:
    """Return the mean of the face centers of each piece, [count, 3]."""
    a, b, c = part.faces.T
    of_faces = ((column[a] + column[b] + column[c]) / 3 for column in part.vertices.T)
    sums = np.stack([np.bincount(piece, weights=column, minlength=count) for column in of_faces])
    return (sums / np.bincount(piece, minlength=count)).T


def _unique(names: Sequence[str]) -> list[str]:
    result: list[str] = []
    for name in names:
        candidates = (name, *(f"{name}_{number}" for number in range(2, len(names) + 2)))
        result.append(next(c for c in candidates if c not in result and (c == name or c not in names)))
    return result

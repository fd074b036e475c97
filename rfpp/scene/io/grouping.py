"""How many objects a file becomes: its parts, its connected components, never too many."""

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

#: The most that a training scene has.
MAX_OBJECTS = 70
#: Of a scan with all its crumbs; more are triangles that nobody has joined.
_MAX_PIECES = 1_000_000


def components(part: Part) -> Iterator[Part]:
    """Its connected pieces, in the order of their first faces; equal positions count as one vertex.

    Raises:
        SceneError: more pieces than are ever told apart.
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
            f"{len(first):,} loose pieces are more than {_MAX_PIECES:,}: join its triangles where it was made"
        )
    if len(first) == 1:
        yield part
        return
    piece = piece.reshape(-1)
    if len(first) > MAX_OBJECTS:  # crumbs are put together first: each is looked at as an object once only
        areas = np.bincount(piece, weights=part.areas)
        largest = np.argsort(-areas, kind="stable")[:MAX_OBJECTS]
        crumbs = np.setdiff1d(np.arange(len(first)), largest)
        centres = _centres(part, piece, len(first))
        body = np.empty(len(first), np.int64)
        body[largest] = np.arange(len(largest))
        body[crumbs] = cKDTree(centres[largest]).query(centres[crumbs])[1]
        first, piece = first[largest], body[piece]
        count = np.bincount(piece)
    by_piece = np.split(np.argsort(piece, kind="stable"), np.cumsum(count)[:-1])
    for index in np.argsort(first):
        yield part.only(by_piece[index])


def merged(parts: Sequence[Part], path: Path) -> list[Part]:
    """At most `MAX_OBJECTS` surfaces and as many lights, with unique names: small parts join the nearest large one.

    Warns if any did.
    """
    kept = [*_merged([p for p in parts if not p.is_light]), *_merged([p for p in parts if p.is_light])]
    if len(kept) < len(parts):
        warnings.warn(f"{path}: {len(parts)} parts became {len(kept)} objects, small ones joined to others",
                      stacklevel=4)  # fmt: skip
    return [replace(part, name=name) for part, name in zip(kept, _unique([p.name for p in kept]), strict=True)]


def _merged(parts: list[Part]) -> list[Part]:
    if len(parts) <= MAX_OBJECTS:
        return parts
    order = np.argsort([-part.areas.sum() for part in parts], kind="stable")
    large, small = np.sort(order[:MAX_OBJECTS]), order[MAX_OBJECTS:]
    centres = np.stack([part.corners.mean(axis=(0, 1)) for part in parts])
    nearest = cKDTree(centres[large]).query(centres[small])[1]
    joining = {index: [index] for index in large}
    for index, body in zip(small, large[nearest], strict=True):
        joining[body].append(index)
    return [_joined([parts[index] for index in indices]) for indices in joining.values()]


def _joined(parts: Sequence[Part]) -> Part:
    """One part, called and shaded like the first."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        material=np.concatenate([part.material for part in parts]),
    )


def _centres(part: Part, piece: np.ndarray, count: int) -> np.ndarray:
    """[count, 3] mean of the faces' centres of each piece."""
    a, b, c = part.faces.T
    of_faces = ((column[a] + column[b] + column[c]) / 3 for column in part.vertices.T)
    sums = np.stack([np.bincount(piece, weights=column, minlength=count) for column in of_faces])
    return (sums / np.bincount(piece, minlength=count)).T


def _unique(names: Sequence[str]) -> list[str]:
    """A number behind each name that was there before."""
    taken: set[str] = set(names)
    seen: set[str] = set()
    result = []
    counts: dict[str, int] = {}
    for name in names:
        unique = name
        while unique in seen or (unique != name and unique in taken):
            counts[name] = counts.get(name, 1) + 1
            unique = f"{name}_{counts[name]}"
        seen.add(unique)
        result.append(unique)
    return result

"""Triangle meshes: valid by construction, normalized, decimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.errors import SceneError

#: Triangles with a smaller height, relative to their longest side, have no direction in float32.
_DEGENERATE_SLIMNESS = 1e-6
#: Odd multipliers that spread the bits of coordinates.
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
#: Triangles processed at a time, so that intermediate results stay in the processor's cache.
_CHUNK = 1 << 14


@dataclass(frozen=True, eq=False)
class Mesh:
    """An indexed triangle mesh, valid by construction.

    Attributes:
        vertices: [V, 3] float32.
        faces: [F, 3] int32 vertex indices, counter-clockwise seen from outside.

    Raises:
        SceneError: If there are no faces, a face index is out of range, or a vertex is NaN or infinite.
    """

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        with np.errstate(over="ignore"):  # values too large for float32 become infinite, reported below
            vertices = np.ascontiguousarray(self.vertices, dtype=np.float32).reshape(-1, 3)
        faces = np.ascontiguousarray(self.faces).reshape(-1, 3)
        if len(faces) == 0:
            raise SceneError("the mesh has no faces: export it with triangles")
        if faces.min() < 0 or faces.max() >= len(vertices):
            bad = int(np.argmax(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
            raise SceneError(f"face {bad} refers to a vertex outside 0…{len(vertices) - 1}: export the mesh again")
        if not np.isfinite(vertices).all():
            bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
            raise SceneError(f"vertex {bad} is NaN or infinite: repair or export the mesh again")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces.astype(np.int32, copy=False))

    def __len__(self) -> int:
        """Return the number of faces."""
        return len(self.faces)

    @property
    def corners(self) -> np.ndarray:
        """[F, 3, 3] corner positions."""
        return self.vertices[self.faces]


def normalized(mesh: Mesh) -> Mesh:
    """Subtract the mean of the vertices and scale so that the farthest vertex is at distance 0.5 (RenderFormer)."""
    centered = mesh.vertices - mesh.vertices.mean(axis=0, dtype=np.float64)
    radius = np.linalg.norm(centered, axis=1).max()
    if radius == 0:
        raise SceneError("all vertices coincide: check the mesh")
    return Mesh(centered * (0.5 / radius), mesh.faces)


def joined(parts: Sequence[Mesh]) -> Mesh:
    """Concatenate the vertices and faces of several meshes."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
    )


def split_faces(whole: Mesh, part_faces: Sequence[int] | Int[np.ndarray, " parts"]) -> tuple[Mesh, ...]:
    """Invert `joined`, given the number of faces of each part; unused vertices are dropped."""
    pieces = []
    for faces in np.split(whole.faces, np.cumsum(part_faces)[:-1]):
        used, renumbered = compacted(faces, len(whole.vertices))
        pieces.append(Mesh(whole.vertices[used], renumbered))
    return tuple(pieces)


def normalized_together(parts: Sequence[Mesh]) -> tuple[Mesh, ...]:
    """Normalize the parts of one object as a whole."""
    return split_faces(normalized(joined(parts)), [len(part) for part in parts])


def decimated(mesh: Mesh, target_faces: int) -> Mesh:
    """Reduce a mesh to at most `target_faces` faces by quadric edge collapse; a smaller mesh is returned unchanged.

    Slivers, as in the caps of a fine cylinder, can stop the collapse early. Then vertices in each cell of an ever
    coarser grid are merged first.

    Raises:
        SceneError: If that many faces cannot be removed, for example from loose triangles.
    """
    if len(mesh) <= target_faces:
        return mesh
    import fast_simplification  # optional dependency, needed only here

    solid = without_degenerate_faces(welded(mesh))
    for grid_cells in (None, 256, 128, 64, 32, 16, 8, 4):
        try:
            coarse = solid if grid_cells is None else _clustered(solid, grid_cells)
            if len(coarse) <= target_faces:
                return coarse
            vertices, faces = fast_simplification.simplify(coarse.vertices, coarse.faces, target_count=target_faces)
            reduced = without_degenerate_faces(Mesh(vertices, faces))
        except SceneError:  # no face is left
            continue
        if len(reduced) <= target_faces:
            return reduced
    raise SceneError(f"the mesh cannot be reduced to {target_faces} faces: raise the target or simplify it by hand")


def without_degenerate_faces(mesh: Mesh) -> Mesh:
    """Drop triangles of zero area and unused vertices.

    Raises:
        SceneError: If no triangle is left.
    """
    solid = has_area(mesh)
    if not solid.any():
        raise SceneError("every triangle has zero area: check the mesh and its scale")
    used, faces = compacted(mesh.faces if solid.all() else mesh.faces[solid], len(mesh.vertices))
    return Mesh(mesh.vertices[used], faces)


def has_area(mesh: Mesh) -> Bool[np.ndarray, " faces"]:
    """Return a mask of the faces that `without_degenerate_faces` keeps."""
    return slimness(mesh) > _DEGENERATE_SLIMNESS


def slimness(mesh: Mesh) -> Float[np.ndarray, " faces"]:
    """Return the height of each triangle over its longest side, relative to that side; 0 for a point."""
    chunks = [mesh.faces[i : i + _CHUNK] for i in range(0, len(mesh), _CHUNK)]
    return np.concatenate([_slimness(mesh.vertices[chunk]) for chunk in chunks])


def triangle_areas(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, " f"]:
    """Return the area of each triangle."""
    chunks = [faces[i : i + _CHUNK] for i in range(0, len(faces), _CHUNK)]
    return np.concatenate([np.empty(0), *(_areas(vertices[chunk]) for chunk in chunks)])


def compacted(faces: Int[np.ndarray, "f 3"], count: int) -> tuple[Int[np.ndarray, " used"], Int[np.ndarray, "f 3"]]:
    """Return the indices of the used vertices out of `count`, in order, and the faces renumbered to them."""
    if faces.size < count // 16:  # few faces of a large file: sorting them is faster than visiting every vertex
        used, renumbered = np.unique(faces, return_inverse=True)
        return used, renumbered.reshape(-1, 3)
    is_used = np.zeros(count, bool)
    is_used[faces] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[faces]


def extent(positions: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Return the minimum and maximum of x, y and z; column by column, which is five times as fast as along rows."""
    return np.array([column.min() for column in positions.T]), np.array([column.max() for column in positions.T])


def distinct(positions: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "d 3"], Int[np.ndarray, " n"]]:
    """Return the distinct positions sorted by x, y, z, and the index of each position among them; -0 equals 0.

    Equivalent to `numpy.unique` along an axis, several times as fast.
    """
    positions = positions + 0.0  # turns -0.0 into 0.0
    first, number = same_positions(positions)
    order = np.lexsort(positions[first].T[::-1])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return positions[first[order]], rank[number]


def same_positions(positions: Float[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, " d"], Int[np.ndarray, " n"]]:
    """Return an index of each distinct position, in arbitrary order, and each position's index among these."""
    bits = (np.ascontiguousarray(positions, np.float64) + 0.0).view(np.uint64)
    bits ^= bits >> np.uint64(32)  # the lower bits of former float32 values are all zero
    key = (bits[:, 0] * _MIXERS[0] + bits[:, 1]) * _MIXERS[1] + bits[:, 2]
    order = np.argsort((key ^ key >> np.uint64(32)) * _MIXERS[2])  # sorts one number per position instead of three
    ordered = positions[order]
    x, y, z = (column[1:] != column[:-1] for column in ordered.T)
    is_new = x | y | z
    if np.count_nonzero(is_new) != np.count_nonzero(np.diff(key[order])):  # distinct positions with equal keys
        order = np.lexsort(positions.T)
        x, y, z = (column[1:] != column[:-1] for column in positions[order].T)
        is_new = x | y | z
    is_new = np.append(True, is_new)[: len(order)]
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new], number


def welded(mesh: Mesh) -> Mesh:
    """Merge vertices at equal positions (an STL file repeats them for every face)."""
    vertices, index = distinct(mesh.vertices)
    return Mesh(vertices, index[mesh.faces])


def _areas(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, " f"]:
    a, b, c = np.moveaxis(corners, (0, 1, 2), (2, 0, 1))
    return _length(_cross(b - a, c - a)) / 2


def _slimness(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, " f"]:
    a, b, c = np.moveaxis(corners.astype(np.float64), (0, 1, 2), (2, 0, 1))  # three times [3, F]
    u, v, w = b - a, c - b, a - c
    longest_squared = np.maximum.reduce([(edge * edge).sum(axis=0) for edge in (u, v, w)])
    return _length(_cross(u, v)) / np.maximum(longest_squared, np.finfo(np.float64).tiny)


def _cross(u: Float[np.ndarray, "3 f"], v: Float[np.ndarray, "3 f"]) -> Float[np.ndarray, "3 f"]:
    """Compute cross products by components, four times as fast as np.cross."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def _length(vectors: Float[np.ndarray, "3 f"]) -> Float[np.ndarray, " f"]:
    return np.sqrt((vectors * vectors).sum(axis=0))


def _clustered(mesh: Mesh, cells: int) -> Mesh:
    """Merge the vertices in each cell of a grid with `cells` cells along the longest side of the bounding box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cell = np.floor((mesh.vertices - low) * (cells / (high - low).max()))
    _, index, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    sums = np.stack([np.bincount(index, weights=column) for column in mesh.vertices.T], axis=1)
    faces = index[mesh.faces]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return without_degenerate_faces(Mesh(sums / count[:, None], faces[np.sort(first)]))

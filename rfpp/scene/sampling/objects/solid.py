"""Building blocks of procedural solids."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from manifold3d import Manifold
from manifold3d import Mesh as ManifoldMesh

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated, slimness
from rfpp.scene.sampling.objects.refinement import is_closed, refined

Rng = np.random.Generator
#: A generator of one kind draws a closed solid with very roughly the given number of faces.
Solid = Callable[[Rng, int], Mesh]

#: A slimmer triangle may lose its area to rounding when it is scaled and moved.
_SLIMMEST = 1e-5
#: Shares of a solid's size by which `closed_decimation` lets its surface move.
_TOLERANCES = (1e-4, 1e-3, 3e-3, 1e-2, 2e-2)


def to_manifold(mesh: Mesh) -> Manifold:
    """A closed mesh as Manifold's; an empty one if it is not closed and consistently oriented."""
    return Manifold(ManifoldMesh(mesh.vertices, mesh.faces.astype(np.uint32)))


def from_manifold(solid: Manifold) -> Mesh:
    """Manifold's triangles."""
    mesh = solid.to_mesh()
    return Mesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def unit_sphere(faces: int) -> Manifold:
    """A unit sphere from a refined octahedron, with 1 to 1.5 times as many faces as asked for."""
    return Manifold.sphere(1.0, 4 * math.ceil(math.sqrt(1.2 * faces / 8)))


def with_face_count(mesh: Mesh, target_faces: int) -> Mesh:
    """The mesh with `target_faces` faces or hardly fewer: decimated from above, refined from below."""
    return refined(decimated(mesh, target_faces), target_faces)


def closed_decimation(mesh: Mesh, target_faces: int) -> Mesh:
    """The closed mesh with at most `target_faces` faces, still closed.

    Where collapsing edges alone tears it open, as on flat sides with many faces, those are made few first, with ever
    more tolerance.

    Raises:
        SceneError: that is not possible.
    """
    reduced = decimated(mesh, target_faces)
    if is_closed(reduced):
        return reduced
    solid, size = to_manifold(mesh), float(np.ptp(mesh.vertices, axis=0).max())
    for tolerance in _TOLERANCES:
        reduced = decimated(from_manifold(solid.simplify(tolerance * size)), target_faces)
        if is_closed(reduced):
            return reduced
    raise SceneError(f"at {target_faces} faces it is not closed any more")


def volume(mesh: Mesh) -> float:
    """The volume a closed mesh encloses, negative if it faces inwards."""
    corners = mesh.corners.astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def is_solid(mesh: Mesh, least_fill: float) -> bool:
    """Closed, facing outwards, no thin sheet and without slivers: all of it is left wherever it is placed in a scene.

    It fills more than the given share of its bounding box.
    """
    fills = volume(mesh) > least_fill * float(np.prod(np.ptp(mesh.vertices, axis=0)))
    return fills and is_closed(mesh) and bool(slimness(mesh).min() > _SLIMMEST)


def grid_faces(index: np.ndarray) -> np.ndarray:
    """[2 · (R - 1) · C, 3] triangles between neighbours of a [R, C] grid of vertex numbers that is closed along C.

    They face outwards where rows follow an axis and columns run counter-clockwise about it.
    """
    here, above = index[:-1], index[1:]
    quads = np.stack([here, np.roll(here, -1, axis=1), np.roll(above, -1, axis=1), above], axis=-1).reshape(-1, 4)
    return quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)

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
#: Draws a closed solid of one kind with roughly the given number of faces.
Solid = Callable[[Rng, int], Mesh]

#: Slimmer triangles may lose their area to rounding when they are transformed.
_SLIMMEST = 1e-5
#: Surface tolerances of `closed_decimation`, relative to a solid's size.
_TOLERANCES = (1e-4, 1e-3, 3e-3, 1e-2, 2e-2)


def to_manifold(mesh: Mesh) -> Manifold:
    """Convert a closed mesh; the result is empty if it is not closed and consistently oriented."""
    return Manifold(ManifoldMesh(mesh.vertices, mesh.faces.astype(np.uint32)))


def from_manifold(solid: Manifold) -> Mesh:
    """Convert to a mesh."""
    mesh = solid.to_mesh()
    return Mesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def unit_sphere(faces: int) -> Manifold:
    """Return a unit sphere from a refined octahedron with 1 to 1.5 times `faces` faces."""
    return Manifold.sphere(1.0, 4 * math.ceil(math.sqrt(1.2 * faces / 8)))


def with_face_count(mesh: Mesh, target_faces: int) -> Mesh:
    """Decimate or refine a mesh to `target_faces` faces or slightly fewer."""
    return refined(decimated(mesh, target_faces), target_faces)


def closed_decimation(mesh: Mesh, target_faces: int) -> Mesh:
    """Decimate a closed mesh to at most `target_faces` faces, keeping it closed.

    If edge collapse opens the mesh, as on flat sides with many faces, these are simplified first, with increasing
    tolerance.

    Raises:
        SceneError: If the mesh cannot be kept closed.
    """
    reduced = decimated(mesh, target_faces)
    if is_closed(reduced):
        return reduced
    solid, size = to_manifold(mesh), float(np.ptp(mesh.vertices, axis=0).max())
    for tolerance in _TOLERANCES:
        reduced = decimated(from_manifold(solid.simplify(tolerance * size)), target_faces)
        if is_closed(reduced):
            return reduced
    raise SceneError(f"at {target_faces} faces it is no longer closed")


def volume(mesh: Mesh) -> float:
    """Return the volume of a closed mesh, negative if it faces inwards."""
    corners = mesh.corners.astype(np.float64)
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def is_solid(mesh: Mesh, least_fill: float) -> bool:
    """Return whether a mesh is closed, faces outwards, has no slivers and fills enough of its bounding box."""
    fills = volume(mesh) > least_fill * float(np.prod(np.ptp(mesh.vertices, axis=0)))
    return fills and is_closed(mesh) and bool(slimness(mesh).min() > _SLIMMEST)


def grid_faces(index: np.ndarray) -> np.ndarray:
    """Return the triangles of a [R, C] grid of vertex indices that is closed along C, [2 · (R - 1) · C, 3].

    They face outwards if rows follow an axis and columns run counter-clockwise around it.
    """
    here, above = index[:-1], index[1:]
    quads = np.stack([here, np.roll(here, -1, axis=1), np.roll(above, -1, axis=1), above], axis=-1).reshape(-1, 4)
    return quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)

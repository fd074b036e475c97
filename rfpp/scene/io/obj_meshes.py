"""OBJ as meshes: positions and faces alone, one mesh for each name after `usemtl`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_TEXT_BYTES, read_bytes
from rfpp.scene.io.obj_faces import ObjFaces
from rfpp.scene.mesh import Mesh, compacted


def read_obj_meshes(path: Path) -> tuple[Mesh, ...]:
    """One for each material, in the order of their first faces; no MTL file is opened.

    Vertices are those that trimesh makes: a position is repeated where its corners have different texture coordinates
    or normals. `normalized` depends on that, and so RenderFormer's scenes do.

    Raises:
        SceneError: without the file's name, but with the line's number.
    """
    file = ObjFaces()
    file.read(read_bytes(path, MAX_TEXT_BYTES))
    of_materials: dict[str, list[np.ndarray]] = {}
    for group, triangles in file.faces():
        of_materials.setdefault(group.material, []).append(triangles)
    positions = file.vectors(b"v")
    has_normals = len(file.vectors(b"vn")) > 0
    groups = [np.concatenate(triangles) for triangles in of_materials.values()]
    if not any(map(len, groups)):
        raise SceneError("the mesh has no faces: export it with triangles")
    meshes = []
    for triangles in filter(len, groups):
        vertices, faces = _unmerged(triangles, len(positions), has_normals)
        meshes.append(Mesh(positions[vertices], faces))
    return tuple(meshes)


def _unmerged(
    triangles: Int[np.ndarray, "f 3 3"], count: int, has_normals: bool
) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, "f 3"]]:
    """Which of `count` positions each vertex of a mesh has, in order, and the faces in terms of these."""
    positions, coordinates, normals = np.moveaxis(triangles, -1, 0)
    split_by = [coordinates] if coordinates.min() >= 0 else []
    if normals.min() >= 0 and (split_by or has_normals):
        split_by.append(normals)
    if not split_by:
        return compacted(positions, count)
    corners = positions.reshape(-1).astype(np.int64)
    of_corners = corners
    for attribute in split_by:
        of_corners = of_corners * (int(attribute.max()) + 1) + attribute.reshape(-1)
        _, first, of_corners = np.unique(of_corners, return_index=True, return_inverse=True)
    return corners[first], of_corners.reshape(-1, 3)

"""Meshes of objects as files, without their materials."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh
from jaxtyping import Int

from rfpp.errors import SceneError
from rfpp.files import write_atomically
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.limits import MAX_TEXT_BYTES, read_bytes
from rfpp.scene.io.obj_faces import ObjFaces
from rfpp.scene.io.ply_file import read_header
from rfpp.scene.io.stl import require_whole_stl
from rfpp.scene.mesh import Mesh, compacted, joined

T = TypeVar("T")

#: Formats of `load_mesh`.
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb")
_GLTF_SUFFIXES = (".gltf", ".glb")


def load_mesh(path: Path) -> Mesh:
    """Read an OBJ, PLY, STL or glTF file, triangulated and without materials and stored normals.

    The meshes of a glTF file are placed by its nodes and joined.

    Raises:
        SceneError: If the file is missing, unreadable, not a valid `Mesh`, claims more than it holds, or names files
            outside its folder.
    """
    return _read(path, _whole)


def load_material_groups(path: Path) -> tuple[Mesh, ...]:
    """Read a file as one mesh per material: by `usemtl` in OBJ, by the meshes of nodes in glTF.

    Raises like `load_mesh`.
    """
    return _read(path, _by_material)


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write an OBJ file that reads back exactly. Raises UserError if it cannot be written."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def _read(path: Path, reader: Callable[[Path], T]) -> T:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise SceneError(f"{path}: '{path.suffix}' is not a mesh format that can be read: export OBJ, PLY, STL or glTF")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such mesh file: correct the path")
    try:
        _require_sound(path)
        return reader(path)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except Exception as error:  # trimesh's readers raise arbitrary errors for malformed files
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SceneError(f"{path}: cannot be read as a mesh ({reason}): export it again") from None


def _require_sound(path: Path) -> None:
    """Check sizes, counts and names of other files before trimesh, which trusts them, reads the file."""
    match path.suffix.lower():
        case ".gltf" | ".glb":
            GltfFile.at(path).require_sound_buffers()
        case ".ply":
            read_header(read_bytes(path))
        case ".stl":
            require_whole_stl(read_bytes(path))


def _whole(path: Path) -> Mesh:
    if path.suffix.lower() == ".obj":
        return joined(_obj_by_material(path))
    if path.suffix.lower() in _GLTF_SUFFIXES:
        loaded = trimesh.load_scene(path, process=False, skip_materials=True).to_mesh()
    else:
        loaded = trimesh.load_mesh(path, process=False, skip_materials=True)
    return Mesh(loaded.vertices, loaded.faces)


def _by_material(path: Path) -> tuple[Mesh, ...]:
    if path.suffix.lower() == ".obj":
        return _obj_by_material(path)
    loaded = trimesh.load_scene(path, process=False, skip_materials=True, group_material=True)
    groups = [group for group in loaded.dump() if isinstance(group, trimesh.Trimesh) and len(group.faces)]
    if not groups:
        raise SceneError("the mesh has no faces: export it with triangles")
    return tuple(Mesh(group.vertices, group.faces) for group in groups)


def _obj_by_material(path: Path) -> tuple[Mesh, ...]:
    """Read an OBJ file as one mesh per material, in the order of their first faces, without opening MTL files.

    Vertices equal trimesh's: a position is repeated where its corners have different texture coordinates or normals.
    `normalized`, and so RenderFormer's scenes, depend on that.
    """
    file = ObjFaces()
    file.read(read_bytes(path, MAX_TEXT_BYTES))
    by_material: dict[str, list[np.ndarray]] = {}
    for group, triangles in file.faces():
        by_material.setdefault(group.material, []).append(triangles)
    groups = [triangles for parts in by_material.values() if len(triangles := np.concatenate(parts))]
    if not groups:
        raise SceneError("the mesh has no faces: export it with triangles")
    positions, has_normals = file.vectors(b"v"), len(file.vectors(b"vn")) > 0
    meshes = []
    for triangles in groups:
        vertices, faces = _split_vertices(triangles, len(positions), has_normals)
        meshes.append(Mesh(positions[vertices], faces))
    return tuple(meshes)


def _split_vertices(
    triangles: Int[np.ndarray, "f 3 3"], count: int, has_normals: bool
) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, "f 3"]]:
    """Return the position index of each vertex, out of `count`, and the faces in terms of these vertices."""
    positions, coordinates, normals = np.moveaxis(triangles, -1, 0)
    split_by = [coordinates] if coordinates.min() >= 0 else []
    if normals.min() >= 0 and (split_by or has_normals):
        split_by.append(normals)
    if not split_by:
        return compacted(positions, count)
    corners = positions.reshape(-1).astype(np.int64)
    vertex_of_corner = corners
    for attribute in split_by:
        vertex_of_corner = vertex_of_corner * (int(attribute.max()) + 1) + attribute.reshape(-1)
        _, first, vertex_of_corner = np.unique(vertex_of_corner, return_index=True, return_inverse=True)
    return corners[first], vertex_of_corner.reshape(-1, 3)

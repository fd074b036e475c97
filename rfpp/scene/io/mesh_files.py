"""Meshes of objects as files, without their materials."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import trimesh

from rfpp.errors import SceneError
from rfpp.files import write_atomically
from rfpp.scene.io.obj_meshes import read_obj_meshes
from rfpp.scene.io.soundness import require_sound
from rfpp.scene.mesh import Mesh, joined

T = TypeVar("T")

#: The formats that `load_mesh` reads.
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb")


def load_mesh(path: Path) -> Mesh:
    """Read an OBJ, PLY, STL or glTF file; polygons are cut into triangles, materials and stored normals are ignored.

    The meshes of a glTF file are placed by its nodes and put together.

    Raises:
        SceneError: naming the file, if it is missing, unreadable or not a valid `Mesh`, claims more than it holds, or
            names files outside its folder.
    """
    return _read(path, _as_one)


def load_material_groups(path: Path) -> tuple[Mesh, ...]:
    """The same file as one mesh for each of its materials: of an OBJ by `usemtl`, of glTF by the meshes of its nodes.

    Raises like `load_mesh`.
    """
    return _read(path, _by_material)


def _as_one(path: Path) -> Mesh:
    if path.suffix.lower() == ".obj":
        return joined(read_obj_meshes(path))
    if path.suffix.lower() in (".gltf", ".glb"):
        loaded = trimesh.load_scene(path, process=False, skip_materials=True).to_mesh()
    else:
        loaded = trimesh.load_mesh(path, process=False, skip_materials=True)
    return Mesh(loaded.vertices, loaded.faces)


def _by_material(path: Path) -> tuple[Mesh, ...]:
    if path.suffix.lower() == ".obj":
        return read_obj_meshes(path)
    loaded = trimesh.load_scene(path, process=False, skip_materials=True, group_material=True)
    groups = [group for group in loaded.dump() if isinstance(group, trimesh.Trimesh) and len(group.faces)]
    if not groups:
        raise SceneError("the mesh has no faces: export it with triangles")
    return tuple(Mesh(group.vertices, group.faces) for group in groups)


def _read(path: Path, reader: Callable[[Path], T]) -> T:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise SceneError(f"{path}: '{path.suffix}' is not a mesh format that can be read: export OBJ, PLY, STL or glTF")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such mesh file: correct the path")
    require_sound(path)
    try:
        return reader(path)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except Exception as error:  # trimesh's readers raise whatever the file makes them stumble over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SceneError(f"{path}: cannot be read as a mesh ({reason}): export it again") from None


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write an OBJ file that reads back exactly. Raises UserError if it cannot be written."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    write_atomically(path, ("\n".join(lines) + "\n").encode())

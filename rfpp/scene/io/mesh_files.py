"""Meshes of objects as files, without their materials."""

from __future__ import annotations

from pathlib import Path

from rfpp.errors import SceneError
from rfpp.files import write_atomically
from rfpp.scene.io.gltf import load_gltf_meshes
from rfpp.scene.io.limits import MAX_TEXT_BYTES, read_bytes
from rfpp.scene.io.trimesh_files import load_obj, load_ply, load_stl
from rfpp.scene.mesh import Mesh, joined

#: Formats of `load_mesh`.
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb")


def load_mesh(path: Path) -> Mesh:
    """Read an OBJ, PLY, STL or glTF file, triangulated and without materials and stored normals.

    The meshes of a glTF file are placed by its nodes and joined. Vertices of other formats equal trimesh's, on which
    normalization and so RenderFormer's scenes depend: a position is repeated where its corners' attributes differ.

    Raises:
        SceneError: If the file is missing, unreadable, not a valid `Mesh`, claims more than it holds, or names files
            outside its folder.
    """
    return joined(load_material_groups(path))


def load_material_groups(path: Path) -> tuple[Mesh, ...]:
    """Read a file as one mesh per material: by `usemtl` in OBJ, by the meshes of nodes in glTF.

    Raises like `load_mesh`.
    """
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise SceneError(f"{path}: '{path.suffix}' is not a mesh format that can be read: export OBJ, PLY, STL or glTF")
    if not path.is_file():
        raise SceneError(f"{path}: there is no such mesh file: correct the path")
    try:
        match suffix:
            case ".obj":
                meshes = load_obj(read_bytes(path, MAX_TEXT_BYTES), by_name=False)[0].values()
            case ".ply":
                meshes = [load_ply(read_bytes(path))]
            case ".stl":
                meshes = load_stl(read_bytes(path))
            case _:
                return load_gltf_meshes(path)
        return tuple(Mesh(mesh["vertices"], mesh["faces"]) for mesh in meshes)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write an OBJ file that reads back exactly. Raises UserError if it cannot be written."""
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    write_atomically(path, ("\n".join(lines) + "\n").encode())

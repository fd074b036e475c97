"""Scenes in OBJ, PLY and STL files.

Each group (`o` or `g`) of an OBJ file in each of its materials becomes a part; elsewhere, each connected component. A
surface is smooth unless its stored normals are those of its faces.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import MAX_OBJECTS, components
from rfpp.scene.io.image_texture import Textures, linear, require_few_pixels
from rfpp.scene.io.imported_scene import DIELECTRIC, ImportedScene, Part, is_smooth, name_of, plain_material
from rfpp.scene.io.limits import MAX_TEXT_BYTES, beside, read_bytes
from rfpp.scene.io.mtl import ObjMaterial, ObjSurface, read_mtl
from rfpp.scene.io.pieces import Pieces
from rfpp.scene.io.texture_detail import TEXTURE_TRIANGLES, TexturedPart, detail_notice, with_detail
from rfpp.scene.io.trimesh_files import TrimeshArrays, load_obj, load_ply, load_stl
from rfpp.scene.triangles import DIFFUSE

_MAX_LIBRARIES = 100


def read_obj(path: Path, detail: int = TEXTURE_TRIANGLES, most: int | None = None) -> ImportedScene:
    """Read an OBJ file and its materials; see `with_detail`.

    Raises:
        SceneError: Without the file's name.
    """
    meshes, libraries = load_obj(read_bytes(path, MAX_TEXT_BYTES), by_name=True)
    if not libraries:
        warnings.warn(f"{path}: names no MTL file: its surfaces are gray", stacklevel=4)
    materials = _materials(path.parent, libraries, {material for _, material in meshes})
    pictures = {picture for material in materials.values() for picture in material.textures.values()}
    require_few_pixels(picture.open("rb") for picture in pictures if picture.is_file())
    textures, unfinished = Textures(), []
    for (name, material), mesh in meshes.items():
        entry = materials.get(material)
        rows = plain_material(len(mesh["faces"]))
        part = _part(name_of(f"{name} {material}", "part"), mesh, rows, entry.see_through if entry else "")
        if entry and entry.is_textured:
            unfinished.append(TexturedPart.whole(part, ObjSurface(entry, mesh, textures)))
        else:
            whole = Pieces.whole(part.corners)
            unfinished.append(replace(part, material=entry.rows(whole, mesh, textures)) if entry else part)
    parts, added = with_detail(unfinished, detail, most)
    if textures.used:
        warnings.warn(f"{path}: {detail_notice(textures.used, added)}", stacklevel=4)
    if omitted := sorted(set().union(*(material.omitted for material in materials.values()))):
        warnings.warn(f"{path}: omitted: {', '.join(omitted)}", stacklevel=4)
    if not any(name for name, _ in meshes) and len(parts) <= MAX_OBJECTS:
        parts = [piece for part in parts for piece in components(part)]
    return ImportedScene(path.stem, tuple(parts))


def read_ply(path: Path) -> ImportedScene:
    """Read a PLY file, whose colors are the diffuse albedo. Raises SceneError, without the file's name."""
    mesh = load_ply(read_bytes(path), fix_texture=False)  # keeps vertices and their colors in the same order
    faces, colors = mesh["faces"], mesh.get("face_colors")
    if colors is None and mesh.get("vertex_colors") is not None:
        colors = mesh["vertex_colors"][faces]
    rows = plain_material(len(faces))
    if colors is not None:
        if len(colors) != len(faces):
            raise SceneError("has colors of polygons: export it again as triangles")
        colors = linear(colors) if colors.dtype == np.uint8 else np.clip(colors, 0, 1)
        rows[:, DIFFUSE] = (1 - DIELECTRIC) * colors[..., :3].reshape(len(faces), -1, 3).mean(axis=1)
    return ImportedScene(path.stem, tuple(components(_part(path.stem, mesh, rows))))


def read_stl(path: Path) -> ImportedScene:
    """Read a text or binary STL file. Raises SceneError, without the file's name."""
    meshes = load_stl(read_bytes(path))
    solids = [_part(path.stem, mesh, plain_material(len(mesh["faces"]))) for mesh in meshes]
    return ImportedScene(path.stem, tuple(piece for solid in solids for piece in components(solid)))


def _materials(folder: Path, libraries: list[str], used: set[str]) -> dict[str, ObjMaterial]:
    """Return the used materials by name; none if there are no libraries."""
    if len(set(libraries)) > _MAX_LIBRARIES:
        raise SceneError(f"more than {_MAX_LIBRARIES} MTL files: join them")
    materials: dict[str, ObjMaterial] = {}
    for library in dict.fromkeys(libraries):
        materials |= read_mtl(beside(folder, library))
    if libraries and (unknown := used - {"", *materials}):
        raise SceneError(f"material '{one_line(min(unknown), 60)}' is in none of its MTL files: add or export it again")
    return {name: material for name, material in materials.items() if name in used}


def _part(name: str, mesh: TrimeshArrays, rows: np.ndarray, see_through: str = "") -> Part:
    vertices, faces, normals = mesh["vertices"], mesh["faces"], mesh.get("vertex_normals")
    smooth = normals is None or is_smooth(vertices, faces, normals, faces)
    return Part(name, vertices, faces, rows, smooth, see_through)

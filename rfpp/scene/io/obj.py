"""OBJ: each `o` or `g` in each of its materials becomes a part; of a file without either, each connected component.

Coordinates are taken as they stand, polygons are cut into fans. A surface is smooth unless stored normals or `s off`
say that it is flat.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import MAX_OBJECTS, components
from rfpp.scene.io.image_texture import Textures, require_few_pixels
from rfpp.scene.io.imported_scene import ImportedScene, Part, is_smooth, name_of, plain_material
from rfpp.scene.io.limits import MAX_TEXT_BYTES, beside, read_bytes
from rfpp.scene.io.mtl import ObjMaterial, read_mtl
from rfpp.scene.io.obj_faces import CORNER, Group, ObjFaces, text_of
from rfpp.scene.io.obj_lines import WIDTHS
from rfpp.scene.mesh import compacted

_MAX_LIBRARIES = 100


def read_obj(path: Path) -> ImportedScene:
    """The scene in an OBJ file. Raises SceneError, without the file's name but with the line's number."""
    reader = _Reader(path.parent)
    reader.read(read_bytes(path, MAX_TEXT_BYTES))
    return ImportedScene(path.stem, tuple(reader.parts(path)))


class _Reader(ObjFaces):
    """With the materials of its libraries."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.libraries: set[Path] = set()
        self.materials: dict[str, ObjMaterial] = {}
        self.textures = Textures()
        self.names_materials = False

    def library(self, line: bytes) -> None:
        self.names_materials = True
        path = beside(self.folder, text_of(line))
        if path not in self.libraries:
            if len(self.libraries) == _MAX_LIBRARIES:
                raise SceneError(f"more than {_MAX_LIBRARIES} MTL files: join them")
            self.libraries.add(path)
            self.materials |= read_mtl(path)

    def parts(self, path: Path) -> list[Part]:
        vertices, coordinates, normals = stored = [self.vectors(key) for key in WIDTHS]
        if not np.isfinite(coordinates).all():
            raise SceneError("a texture coordinate is NaN or infinite: export it again")
        corners = np.frombuffer(self.corners, np.int32).reshape(-1, 3)
        for what, there, used in zip(CORNER, stored, corners.max(axis=0, initial=-1).tolist(), strict=True):
            if used >= len(there):
                raise SceneError(f"a face refers to {what} {used + 1} of {len(there)}: export it again")
        self._require_few_pixels()
        parts = [self._part(group, rows, vertices, coordinates, normals) for group, rows in self.faces()]
        if not self.names_materials:
            warnings.warn(f"{path}: names no MTL file: its surfaces are grey", stacklevel=4)
        if self.textures.used:
            warnings.warn(f"{path}: textures are averaged over each triangle ({self.textures.used})", stacklevel=4)
        if self.names_parts or len(parts) > MAX_OBJECTS:
            return parts
        return [piece for part in parts for piece in components(part)]

    def _part(
        self, group: Group, triangles: np.ndarray, vertices: np.ndarray, coordinates: np.ndarray, normals: np.ndarray
    ) -> Part:
        """Of [F, 3 corners, 3] indices of vertices, texture coordinates and normals."""
        used, faces = compacted(triangles[..., 0], len(vertices))
        vertices, (mapped, shaded) = vertices[used], np.moveaxis(triangles[..., 1:], -1, 0)
        uv = coordinates[mapped] * (1, -1) + (0, 1) if len(mapped) and mapped.min() >= 0 else None
        smooth = not group.flat
        if len(shaded) and shaded.min() >= 0:
            smooth = is_smooth(vertices, faces, normals, shaded)
        label = name_of(" ".join(filter(None, (group.name, group.material))), "part")
        material = self._material(group.material)
        rows = material.rows(uv, len(faces), self.textures) if material else plain_material(len(faces))
        return Part(label, vertices, faces, rows, smooth, material.see_through if material else "")

    def _material(self, name: str) -> ObjMaterial | None:
        if not self.names_materials or not name:
            return None
        if name not in self.materials:
            raise SceneError(f"material '{one_line(name, 60)}' is in none of its MTL files: add it or export it again")
        return self.materials[name]

    def _require_few_pixels(self) -> None:
        """Raises SceneError for too many in all its textures, before any is decoded."""
        materials = {group.material: self._material(group.material) for group in self.described}
        paths = {path for material in materials.values() if material for path in material.pictures}
        require_few_pixels(path.open("rb") for path in paths if path.is_file())

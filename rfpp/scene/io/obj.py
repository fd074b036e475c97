"""OBJ: each `o` or `g` in each of its materials becomes a part; of a file without either, each connected component.

Coordinates are taken as they stand, polygons are cut into fans. A surface is smooth unless stored normals or `s off`
say that it is flat.
"""

from __future__ import annotations

import math
import warnings
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import components
from rfpp.scene.io.image_texture import Textures
from rfpp.scene.io.imported_scene import ImportedScene, Part, fans, name_of, plain_material
from rfpp.scene.io.limits import MAX_TEXT_BYTES, beside, read_bytes, require_bounded
from rfpp.scene.io.mtl import ObjMaterial, read_mtl
from rfpp.scene.io.obj_runs import Run, runs

_FLAT_COSINE = math.cos(math.radians(1))
_MAX_LIBRARIES = 100
_WIDTHS = {b"v": 3, b"vt": 2, b"vn": 3}


@dataclass
class _Group:
    """Faces of one name and one material, corner by corner."""

    name: str
    material: str
    sizes: array = field(default_factory=lambda: array("q"))
    corners: array = field(default_factory=lambda: array("q"))  # vertex, texture coordinate, normal; -1 is none
    flat: bool = False


def read_obj(path: Path) -> ImportedScene:
    """The scene in an OBJ file. Raises SceneError, without the file's name but with the line's number."""
    reader = _Reader(path.parent)
    for run in runs(read_bytes(path, MAX_TEXT_BYTES)):
        if not reader.take_run(run):
            for number, line in enumerate(run.text.split(b"\n"), start=run.first):
                _take(reader, number, line)
    return ImportedScene(path.stem, tuple(reader.parts(path)))


def _take(reader: _Reader, number: int, line: bytes) -> None:
    """Raises SceneError with the line's number."""
    tokens = line.split()
    if not tokens:
        return
    try:
        reader.take(tokens, line)
    except SceneError as error:
        raise SceneError(f"line {number}: {error}") from None
    except (ValueError, OverflowError):
        text = one_line(line.decode("utf-8", "replace").strip(), 40)
        raise SceneError(f"line {number}: '{text}' cannot be read: export it again") from None


class _Reader:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.arrays = {key: array("d") for key in _WIDTHS}
        self.libraries: set[Path] = set()
        self.materials: dict[str, ObjMaterial] = {}
        self.textures = Textures()
        self.groups: dict[tuple[str, str], _Group] = {}
        self.name, self.material = "", ""
        self.names_materials = self.names_parts = False
        self.flat = False
        self.triangles = 0

    def take_run(self, run: Run) -> bool:
        """Lines of one keyword at once; False: take them one by one."""
        if run.key in _WIDTHS:
            values = run.vectors(_WIDTHS[run.key])
            if values is not None:
                self.arrays[run.key].frombytes(values.tobytes())
            return values is not None
        corners = run.polygons(self._counts()) if run.key == b"f" else None
        if corners is None:
            return False
        group, (count, size, _) = self._group(), corners.shape
        group.corners.frombytes(corners.tobytes())
        group.sizes.extend([size] * count)
        self._count(count * max(size - 2, 0))
        return True

    def take(self, tokens: list[bytes], line: bytes) -> None:
        """One line that is not empty."""
        key = tokens[0]
        if key in _WIDTHS:
            values = [float(token) for token in tokens[1 : 1 + _WIDTHS[key]]]
            if len(values) < _WIDTHS[key]:
                raise SceneError(f"{_WIDTHS[key]} numbers were expected: export it again")
            self.arrays[key].extend(values)
        elif key == b"f":
            self._face(tokens[1:])
        elif key in (b"o", b"g"):
            self.name, self.names_parts = _text(line), True
        elif key == b"usemtl":
            self.material = _text(line)
        elif key == b"s":
            self.flat = tokens[1:2] in ([b"off"], [b"0"])
        elif key == b"mtllib":
            self.names_materials = True
            path = beside(self.folder, _text(line))
            if path not in self.libraries:
                if len(self.libraries) == _MAX_LIBRARIES:
                    raise SceneError(f"more than {_MAX_LIBRARIES} MTL files: join them")
                self.libraries.add(path)
                self.materials |= read_mtl(path)

    def parts(self, path: Path) -> list[Part]:
        vertices, coordinates, normals = (
            np.array(self.arrays[key]).reshape(-1, width) for key, width in _WIDTHS.items()
        )
        if not np.isfinite(coordinates).all():
            raise SceneError("a texture coordinate is NaN or infinite: export it again")
        parts = [self._part(group, vertices, coordinates, normals) for group in self.groups.values()]
        if not self.names_materials:
            warnings.warn(f"{path}: names no MTL file: its surfaces are grey", stacklevel=4)
        if self.textures.used:
            warnings.warn(f"{path}: textures are averaged over each triangle ({self.textures.used})", stacklevel=4)
        return parts if self.names_parts else [piece for part in parts for piece in components(part)]

    def _counts(self) -> list[int]:
        """Of vertices, texture coordinates and normals so far."""
        return [len(self.arrays[key]) // width for key, width in _WIDTHS.items()]

    def _group(self) -> _Group:
        if (self.name, self.material) not in self.groups:
            self.groups[self.name, self.material] = _Group(self.name, self.material, flat=self.flat)
            require_bounded(self.triangles, len(self.groups))
        return self.groups[self.name, self.material]

    def _count(self, triangles: int) -> None:
        self.triangles += triangles
        require_bounded(self.triangles)

    def _face(self, tokens: list[bytes]) -> None:
        group, counts = self._group(), self._counts()
        size = 0
        for token in tokens:
            if token[:1] == b"#":
                break
            written = token.split(b"/")
            corner = [-1, -1, -1]
            for place, text in enumerate(written[:3]):
                if text:
                    index = int(text)
                    corner[place] = index - 1 if index > 0 else counts[place] + index
                    if index == 0 or corner[place] < 0:
                        what = ("vertex", "texture coordinate", "normal")[place]
                        raise SceneError(f"the face refers to {what} {index} of {counts[place]}: export it again")
            if corner[0] < 0:
                raise SceneError("a corner without a vertex: export it again")
            group.corners.extend(corner)
            size += 1
        group.sizes.append(size)
        self._count(max(size - 2, 0))

    def _part(self, group: _Group, vertices: np.ndarray, coordinates: np.ndarray, normals: np.ndarray) -> Part:
        corners = np.array(group.corners, np.int64).reshape(-1, 3)
        for column, (what, there) in enumerate((("vertex", vertices), ("texture coordinate", coordinates),
                                                ("normal", normals))):  # fmt: skip
            if len(corners) and corners[:, column].max() >= len(there):
                index = corners[:, column].max() + 1
                raise SceneError(f"a face refers to {what} {index} of {len(there)}: export it again")
        triangles, _ = fans(np.array(group.sizes, np.int64))
        faces, mapped, shaded = np.moveaxis(corners[triangles], -1, 0)
        uv = coordinates[mapped] * (1, -1) + (0, 1) if len(mapped) and mapped.min() >= 0 else None
        smooth = not group.flat
        if len(shaded) and shaded.min() >= 0:
            smooth = _is_smooth(vertices[faces], normals[shaded])
        label = name_of(" ".join(filter(None, (group.name, group.material))), "part")
        material = self._material(group.material)
        rows = material.rows(uv, len(faces), self.textures) if material else plain_material(len(faces))
        part = Part(label, vertices, faces, rows, smooth, material.see_through if material else "")
        return part.only(np.arange(len(faces)))

    def _material(self, name: str) -> ObjMaterial | None:
        if not self.names_materials or not name:
            return None
        if name not in self.materials:
            raise SceneError(f"material '{one_line(name, 60)}' is in none of its MTL files: add it or export it again")
        return self.materials[name]


def _is_smooth(corners: np.ndarray, normals: np.ndarray) -> bool:
    """Whether a stored normal differs from its face's by more than a degree."""
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(of_faces, axis=-1)[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        return bool((np.abs((normals * of_faces[:, None]).sum(-1)) < _FLAT_COSINE * lengths).any())


def _text(line: bytes) -> str:
    """What follows the keyword, which may hold spaces."""
    return line.decode("utf-8", "replace").strip().partition(" ")[2].strip()

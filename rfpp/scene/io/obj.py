"""OBJ: each `o` or `g` in each of its materials becomes a part; of a file without either, each connected component.

Coordinates are taken as they stand, polygons are cut into fans. A surface is smooth unless stored normals or `s off`
say that it is flat.
"""

from __future__ import annotations

import warnings
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import MAX_OBJECTS, components
from rfpp.scene.io.image_texture import Textures, require_few_pixels
from rfpp.scene.io.imported_scene import ImportedScene, Part, fans, is_smooth, name_of, plain_material
from rfpp.scene.io.limits import MAX_SINGLE_LINES, MAX_TEXT_BYTES, beside, read_bytes, require_bounded
from rfpp.scene.io.mtl import ObjMaterial, read_mtl
from rfpp.scene.io.number_lines import FEW_LINES
from rfpp.scene.io.obj_lines import WIDTHS, Block, blocks
from rfpp.scene.mesh import compacted

_MAX_LIBRARIES = 100
#: What a corner of a face refers to.
_CORNER = ("vertex", "texture coordinate", "normal")


@dataclass(frozen=True)
class _Group:
    """Faces of one name and one material."""

    name: str
    material: str
    flat: bool


def read_obj(path: Path) -> ImportedScene:
    """The scene in an OBJ file. Raises SceneError, without the file's name but with the line's number."""
    reader = _Reader(path.parent)
    for block in blocks(read_bytes(path, MAX_TEXT_BYTES)):
        _take(reader, block)
    return ImportedScene(path.stem, tuple(reader.parts(path)))


def _take(reader: _Reader, block: Block) -> None:
    """All of a block at once, or in smaller and smaller pieces, at last line by line."""
    if reader.take_block(block):
        return
    if len(block) > FEW_LINES:
        for piece in block.pieces(max(len(block) // 16, FEW_LINES)):
            _take(reader, piece)
        return
    reader.count_single(len(block))
    for number in range(len(block)):
        _take_line(reader, block.first + number, block.line(number))


def _take_line(reader: _Reader, number: int, line: bytes) -> None:
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
        self.arrays = {key: array("d") for key in WIDTHS}
        self.sizes, self.group_of, self.corners = array("i"), array("i"), array("i")  # corners of each face, and so on
        self.libraries: set[Path] = set()
        self.materials: dict[str, ObjMaterial] = {}
        self.textures = Textures()
        self.groups: dict[tuple[str, str], int] = {}
        self.described: list[_Group] = []
        self.name, self.material = "", ""
        self.names_materials = self.names_parts = False
        self.flat = False
        self.triangles = self.single = 0

    def take_block(self, block: Block) -> bool:
        """Every line of it; False: nothing was taken, for some have to be read one by one."""
        if block.has_indented_lines:
            return False
        vectors = [block.vectors(key) for key in WIDTHS]
        faces = block.polygons(self._counts())
        if faces is None or any(values is None for values in vectors):
            return False
        for key, values in zip(WIDTHS, vectors, strict=True):
            self.arrays[key].frombytes(values.tobytes())
        sizes, corners = faces
        groups, done = np.empty(len(sizes), np.int32), 0
        for number, before in zip(block.others.tolist(), block.faces_before[block.others].tolist(), strict=True):
            if before > done:
                groups[done:before] = self._group()
                done = before
            _take_line(self, block.first + number, block.line(number))
        if done < len(sizes):
            groups[done:] = self._group()
        for store, values in ((self.sizes, sizes), (self.group_of, groups), (self.corners, corners)):
            store.frombytes(values.astype(np.int32).tobytes())
        self._count(int(np.maximum(sizes - 2, 0).sum()))
        return True

    def count_single(self, lines: int) -> None:
        self.single += lines
        if self.single > MAX_SINGLE_LINES:
            raise SceneError(f"more than {MAX_SINGLE_LINES:,} of its lines are written unusually, indented, with "
                             "comments or corners in several notations: export it again")  # fmt: skip

    def take(self, tokens: list[bytes], line: bytes) -> None:
        """One line that is not empty."""
        key = tokens[0]
        if key in WIDTHS:
            values = [float(token) for token in tokens[1 : 1 + WIDTHS[key]]]
            if len(values) < WIDTHS[key]:
                raise SceneError(f"{WIDTHS[key]} numbers were expected: export it again")
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
        vertices, coordinates, normals = stored = [
            np.frombuffer(self.arrays[key]).reshape(-1, width) for key, width in WIDTHS.items()
        ]
        if not np.isfinite(coordinates).all():
            raise SceneError("a texture coordinate is NaN or infinite: export it again")
        corners = np.frombuffer(self.corners, np.int32).reshape(-1, 3)
        for what, there, used in zip(_CORNER, stored, corners.max(axis=0, initial=-1).tolist(), strict=True):
            if used >= len(there):
                raise SceneError(f"a face refers to {what} {used + 1} of {len(there)}: export it again")
        places, polygon = fans(np.frombuffer(self.sizes, np.int32))
        triangles = corners[places]
        if len(self.described) > 1:
            group_of = np.frombuffer(self.group_of, np.int32)[polygon]
            triangles = triangles[np.argsort(group_of, kind="stable")]
            ends = np.cumsum(np.bincount(group_of, minlength=len(self.described)))
            of_groups = np.split(triangles, ends[:-1])
        else:
            of_groups = [triangles]
        self._require_few_pixels()
        parts = [
            self._part(group, rows, vertices, coordinates, normals)
            for group, rows in zip(self.described, of_groups, strict=False)
        ]
        if not self.names_materials:
            warnings.warn(f"{path}: names no MTL file: its surfaces are grey", stacklevel=4)
        if self.textures.used:
            warnings.warn(f"{path}: textures are averaged over each triangle ({self.textures.used})", stacklevel=4)
        if self.names_parts or len(parts) > MAX_OBJECTS:
            return parts
        return [piece for part in parts for piece in components(part)]

    def _counts(self) -> list[int]:
        """Of vertices, texture coordinates and normals so far."""
        return [len(self.arrays[key]) // width for key, width in WIDTHS.items()]

    def _group(self) -> int:
        """The number of the group to which faces belong now."""
        key = self.name, self.material
        if key not in self.groups:
            self.groups[key] = len(self.described)
            self.described.append(_Group(*key, flat=self.flat))
            require_bounded(self.triangles, len(self.described))
        return self.groups[key]

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
                        raise SceneError(
                            f"the face refers to {_CORNER[place]} {index} of {counts[place]}: export it again"
                        )
            if corner[0] < 0:
                raise SceneError("a corner without a vertex: export it again")
            self.corners.extend(corner)
            size += 1
        self.sizes.append(size)
        self.group_of.append(group)
        self._count(max(size - 2, 0))

    def _part(
        self, group: _Group, triangles: np.ndarray, vertices: np.ndarray, coordinates: np.ndarray, normals: np.ndarray
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


def _text(line: bytes) -> str:
    """What follows the keyword, which may hold spaces."""
    return line.decode("utf-8", "replace").strip().partition(" ")[2].strip()

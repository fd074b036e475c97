"""The faces of an OBJ file and the groups they belong to: what scenes and single meshes are made of."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.imported_scene import fans
from rfpp.scene.io.limits import MAX_SINGLE_LINES, require_bounded
from rfpp.scene.io.number_lines import FEW_LINES
from rfpp.scene.io.obj_lines import WIDTHS, Block, blocks

#: What a corner of a face refers to.
CORNER = ("vertex", "texture coordinate", "normal")


@dataclass(frozen=True)
class Group:
    """Faces of one name and one material."""

    name: str
    material: str
    flat: bool


class ObjFaces:
    """All lines of a file, one by one or a block at a time. Materials are names here; `library` may find out more.

    Attributes:
        described: the groups in the order of their first faces.
    """

    def __init__(self) -> None:
        self.arrays = {key: array("d") for key in WIDTHS}
        # Of each face: how many corners, in which group, on which line; of each corner: what it refers to.
        self.sizes, self.group_of, self.lines, self.corners = array("i"), array("i"), array("i"), array("i")
        self.groups: dict[tuple[str, str], int] = {}
        self.described: list[Group] = []
        self.name, self.material = "", ""
        self.names_parts = False
        self.flat = False
        self.triangles = self.single = 0

    def read(self, content: bytes) -> None:
        """Raises SceneError, without the file's name but with the line's number."""
        for block in blocks(content):
            self._take(block)
        self._require_vertices()

    def library(self, line: bytes) -> None:
        """What an `mtllib` line means: nothing where materials are ignored."""

    def vectors(self, key: bytes) -> Float[np.ndarray, "n width"]:
        """All of one keyword."""
        return np.frombuffer(self.arrays[key]).reshape(-1, WIDTHS[key])

    def faces(self) -> list[tuple[Group, Int[np.ndarray, "f 3 3"]]]:
        """The triangles of each group: vertex, texture coordinate and normal at each corner, -1 for none."""
        places, polygon = fans(np.frombuffer(self.sizes, np.int32))
        triangles = np.frombuffer(self.corners, np.int32).reshape(-1, 3)[places]
        if len(self.described) < 2:
            return [(group, triangles) for group in self.described]
        group_of = np.frombuffer(self.group_of, np.int32)[polygon]
        triangles = triangles[np.argsort(group_of, kind="stable")]
        ends = np.cumsum(np.bincount(group_of, minlength=len(self.described)))
        return list(zip(self.described, np.split(triangles, ends[:-1]), strict=True))

    def _take(self, block: Block) -> None:
        """All of a block at once, or in smaller and smaller pieces, at last line by line."""
        if self._take_block(block):
            return
        if len(block) > FEW_LINES:
            for piece in block.pieces(max(len(block) // 16, FEW_LINES)):
                self._take(piece)
            return
        self._count_single(len(block))
        for number in range(len(block)):
            self._take_line(block.first + number, block.line(number))

    def _take_line(self, number: int, line: bytes) -> None:
        tokens = line.split()
        if not tokens:
            return
        try:
            self._take_tokens(tokens, line, number)
        except SceneError as error:
            raise SceneError(f"line {number}: {error}") from None
        except (ValueError, OverflowError):
            text = one_line(line.decode("utf-8", "replace").strip(), 40)
            raise SceneError(f"line {number}: '{text}' cannot be read: export it again") from None

    def _take_block(self, block: Block) -> bool:
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
            self._take_line(block.first + number, block.line(number))
        if done < len(sizes):
            groups[done:] = self._group()
        lines = block.first + block.faces
        stores = {"sizes": sizes, "group_of": groups, "lines": lines, "corners": corners}
        for name, values in stores.items():
            getattr(self, name).frombytes(values.astype(np.int32).tobytes())
        self._count(int(np.maximum(sizes - 2, 0).sum()))
        return True

    def _count_single(self, lines: int) -> None:
        self.single += lines
        if self.single > MAX_SINGLE_LINES:
            raise SceneError(f"more than {MAX_SINGLE_LINES:,} of its lines are written unusually, indented, with "
                             "comments or corners in several notations: export it again")  # fmt: skip

    def _take_tokens(self, tokens: list[bytes], line: bytes, number: int) -> None:
        """One line that is not empty, and its number."""
        key = tokens[0]
        if key in WIDTHS:
            values = [float(token) for token in tokens[1 : 1 + WIDTHS[key]]]
            if len(values) < WIDTHS[key]:
                raise SceneError(f"{WIDTHS[key]} numbers were expected: export it again")
            self.arrays[key].extend(values)
        elif key == b"f":
            self._face(tokens[1:], number)
        elif key in (b"o", b"g"):
            self.name, self.names_parts = text_of(line), True
        elif key == b"usemtl":
            self.material = text_of(line)
        elif key == b"s":
            self.flat = tokens[1:2] in ([b"off"], [b"0"])
        elif key == b"mtllib":
            self.library(line)

    def _counts(self) -> list[int]:
        """Of vertices, texture coordinates and normals so far."""
        return [len(self.arrays[key]) // width for key, width in WIDTHS.items()]

    def _group(self) -> int:
        """The number of the group to which faces belong now."""
        key = self.name, self.material
        if key not in self.groups:
            self.groups[key] = len(self.described)
            self.described.append(Group(*key, flat=self.flat))
            require_bounded(self.triangles, len(self.described))
        return self.groups[key]

    def _count(self, triangles: int) -> None:
        self.triangles += triangles
        require_bounded(self.triangles)

    def _face(self, tokens: list[bytes], number: int) -> None:
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
                            f"the face refers to {CORNER[place]} {index} of {counts[place]}: export it again"
                        )
            if corner[0] < 0:
                raise SceneError("a corner without a vertex: export it again")
            self.corners.extend(corner)
            size += 1
        self.sizes.append(size)
        self.group_of.append(group)
        self.lines.append(number)
        self._count(max(size - 2, 0))

    def _require_vertices(self) -> None:
        """Raises SceneError at the first face that names a vertex which the file does not have."""
        vertices = np.frombuffer(self.corners, np.int32)[::3]
        there = len(self.vectors(b"v"))
        if vertices.max(initial=-1) < there:
            return
        bad = int(np.argmax(vertices >= there))
        face = int(np.searchsorted(np.cumsum(np.frombuffer(self.sizes, np.int32)), bad, side="right"))
        raise SceneError(
            f"line {self.lines[face]}: the face refers to vertex {vertices[bad] + 1} of {there}: export it again"
        )


def text_of(line: bytes) -> str:
    """What follows the keyword, which may hold spaces."""
    return line.decode("utf-8", "replace").strip().partition(" ")[2].strip()

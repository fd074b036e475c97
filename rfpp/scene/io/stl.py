"""STL, text or binary: each connected component becomes a grey part, smooth where it is flatter than a crease."""

from __future__ import annotations

import struct
from array import array
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import components
from rfpp.scene.io.imported_scene import ImportedScene, Part, plain_material
from rfpp.scene.io.limits import MAX_SINGLE_LINES, MAX_TEXT_BYTES, read_bytes, require_bounded
from rfpp.scene.io.number_lines import LINES, SPACE, characters, line_bounds, lines_where, numbers, token_starts

_HEADER, _VERTEX = 84, b"vertex"
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> ImportedScene:
    """Raises SceneError, without the file's name."""
    content = read_bytes(path)
    corners = _from_bytes(content) if _is_binary(content) else _from_text(content)
    if not len(corners):
        raise SceneError("holds no triangles: export it again")
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    part = Part(path.stem, corners.reshape(-1, 3), faces, plain_material(len(faces)), smooth=True)
    return ImportedScene(path.stem, tuple(components(part)))


def require_whole_stl(content: bytes) -> None:
    """Raises SceneError where the header of a binary file claims other than what is there."""
    if _is_binary(content):
        (count,) = struct.unpack_from("<I", content, _HEADER - 4)
        require_bounded(count)


def _is_binary(content: bytes) -> bool:
    """By its size alone: many binary headers begin with "solid" as text does."""
    if len(content) >= _HEADER:
        (count,) = struct.unpack_from("<I", content, _HEADER - 4)
        if len(content) == _HEADER + count * _FACET.itemsize:
            return True
        if not content.lstrip().startswith(b"solid"):
            raise SceneError(f"its header claims {count:,} triangles and {len(content) - _HEADER:,} bytes follow: "
                             "copy or export it again")  # fmt: skip
    return False


def _from_bytes(content: bytes) -> Float[np.ndarray, "f 3 3"]:
    facets = np.frombuffer(content, _FACET, offset=_HEADER)
    require_bounded(len(facets))
    return facets["corners"].astype(np.float64)


def _from_text(content: bytes) -> Float[np.ndarray, "f 3 3"]:
    if not content.lstrip().startswith(b"solid"):
        raise SceneError("is no STL file: export it again")
    if len(content) > MAX_TEXT_BYTES:
        raise SceneError(f"holds {len(content):,} bytes of text: save it as binary STL")
    text = characters(content)
    bounds = line_bounds(text)
    chunks, single = [], 0
    for first in range(0, len(bounds) - 1, LINES):
        of_chunk = bounds[first : first + LINES + 1]
        vertices = _vertices(text, of_chunk)
        if vertices is None:
            single += len(of_chunk) - 1
            if single > MAX_SINGLE_LINES:
                raise SceneError(f"more than {MAX_SINGLE_LINES:,} of its lines are written unusually: "
                                 "save it as binary STL")  # fmt: skip
            vertices = _vertices_one_by_one(content, of_chunk.tolist(), first + 1)
        chunks.append(vertices)
    vertices = np.concatenate(chunks)
    if len(vertices) % 3:
        raise SceneError("ends within a triangle: copy or export it again")
    require_bounded(len(vertices) // 3)
    return vertices.reshape(-1, 3, 3)


def _vertices(text: np.ndarray, bounds: np.ndarray) -> Float[np.ndarray, "v 3"] | None:
    """Of some lines of a text; None: take them one by one."""
    text, bounds = text[bounds[0] : bounds[-1]], bounds - bounds[0]
    begins = np.append(token_starts(text), len(text))
    first = begins[np.searchsorted(begins, bounds[:-1])]  # of a later line, if this one is empty
    padded = np.append(text, np.full(len(_VERTEX) + 1, ord("\n"), np.uint8))
    named = (padded[first[:, None] + np.arange(len(_VERTEX))] == np.frombuffer(_VERTEX, np.uint8)).all(axis=1)
    named &= SPACE[padded[first + len(_VERTEX)]] & (first < bounds[1:])
    picked, bounds_of = lines_where(text, bounds, named)
    keyword = bounds_of[:-1] + (first - bounds[:-1])[named]
    picked[keyword[:, None] + np.arange(len(_VERTEX))] = ord(" ")
    found = numbers(picked, bounds_of)
    return found[0].reshape(-1, 3) if found is not None and (found[1] == 3).all() else None


def _vertices_one_by_one(content: bytes, bounds: list[int], number: int) -> Float[np.ndarray, "v 3"]:
    """`number` is that of the first line. Raises SceneError with the line's number."""
    values = array("d")
    for line_number, (begin, end) in enumerate(pairwise(bounds), start=number):
        tokens = content[begin:end].split()
        if tokens[:1] == [_VERTEX]:
            try:
                x, y, z = map(float, tokens[1:])
            except ValueError:
                text = one_line(content[begin:end].decode("ascii", "replace").strip(), 40)
                raise SceneError(f"line {line_number}: '{text}' is no vertex: export it again") from None
            values.extend((x, y, z))
    return np.array(values).reshape(-1, 3)

"""STL, text or binary: each connected component becomes a grey part, smooth where it is flatter than a crease."""

from __future__ import annotations

import struct
from array import array
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.grouping import components
from rfpp.scene.io.imported_scene import ImportedScene, Part, plain_material
from rfpp.scene.io.limits import MAX_TEXT_BYTES, lines_of, read_bytes, require_bounded

_HEADER = 84
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
    numbers = array("d")
    for line_number, line in enumerate(lines_of(content), start=1):
        tokens = line.split()
        if tokens[:1] == [b"vertex"]:
            try:
                x, y, z = map(float, tokens[1:])
            except ValueError:
                text = one_line(line.decode("ascii", "replace").strip(), 40)
                raise SceneError(f"line {line_number}: '{text}' is no vertex: export it again") from None
            numbers.extend((x, y, z))
    if len(numbers) % 9:
        raise SceneError("ends within a triangle: copy or export it again")
    require_bounded(len(numbers) // 9)
    return np.array(numbers).reshape(-1, 3, 3)

"""OBJ, PLY and STL files by trimesh's loaders, which return plain arrays and are given no other file to open.

trimesh trusts counts in headers and skips text that it does not understand. In OBJ it takes index 0 for 1 and counts
negative indices from the end of the file. Content is checked for all of these first.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from trimesh.exchange import obj, ply, stl
from trimesh.geometry import triangulate_quads

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.limits import MAX_PARTS, MAX_TEXT_BYTES, MAX_TRIANGLES, require_bounded

#: Keyword arguments of `trimesh.Trimesh`; `vertices` are float64 [V, 3], `faces` triangles [F, 3].
TrimeshArrays = dict[str, Any]

_NUMBER = rb"[ \t]+[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?+"  # neither NaN nor infinite
_CORNERS = (b"i/?/?", b"i/i/?", b"i//i", b"i/i/i")  # a face uses one notation
_FACE = b"|".join(rb"(?: +%b)++" % corner.replace(b"i", rb"[1-9]\d*+") for corner in _CORNERS)
_BAD_OBJ_LINE = re.compile(
    rb"(?m)^(?=v[tn]? |f )(?!(?:vn?(?:%b){3,}+|vt(?:%b){2,3}+|f(?:%b)) *$).*" % (_NUMBER, _NUMBER, _FACE)
)
_OTHER_OBJ_LINE = re.compile(rb"(?m)^(?!v[tn]? |f )(\S+)(.*)$")
_MAX_OTHER_OBJ_LINES, _MAX_OBJ_NUMBERS = 1_000_000, 2**24
_MAX_OBJ_GROUPS = 2 * MAX_PARTS  # `g` before `usemtl` makes two: with the previous material, and with its own
#: Groups times vertices above which faces get a normal; without normals, trimesh visits all vertices for each group.
_MANY_OBJ_VISITS = 10**9
_PLY_HEADER = re.compile(rb"\Aply\s.{0,65536}?end_header[^\n]*\n", re.DOTALL)
_BAD_STL_VERTEX = re.compile(rb"(?i)(?<!solid )\bvertex\b(?!(?:%b){3}[ \t\r]*\n)[^\n]*" % _NUMBER)
_STL_HEADER, _STL_FACET = 84, 50  # bytes
_MAX_STL_SOLIDS = 2000  # trimesh compares the names of all


def load_obj(content: bytes, by_name: bool) -> tuple[dict[tuple[str, str], TrimeshArrays], list[str]]:
    """Load the mesh of each group in an OBJ file.

    Args:
        by_name: Distinguish groups by name and material; otherwise by material.

    Returns:
        The mesh of each name and material, in the order of their first faces, and the names of MTL files.
    """
    text = content.replace(b"\r\n", b"\n").replace(b"\\\n", b"  ").translate(bytes.maketrans(b"\t\v\f\r", b"    "))
    text = b"\n" + re.sub(rb"(?m)^ +", b"", text)
    if b"#" in text:
        text = re.sub(rb"(?m)^((?:v[tn]?|f) [^#\n]*)#.*", rb"\1", text)
    if bad := _BAD_OBJ_LINE.search(text):
        raise SceneError(f"'{_shown(bad[0])}' cannot be read: export it again, with positive indices")
    faces = text.count(b"\nf ")
    others = text.count(b"\n") - text.count(b"\nv") - faces
    if faces > MAX_TRIANGLES or others > _MAX_OTHER_OBJ_LINES or text.count(b" ") > _MAX_OBJ_NUMBERS:
        raise SceneError(f"more than {MAX_TRIANGLES:,} faces, {_MAX_OBJ_NUMBERS:,} numbers or {_MAX_OTHER_OBJ_LINES:,} "
                         "lines of groups and the like: decimate it in the original program")  # fmt: skip
    numbers, libraries, group = {("", ""): 0}, [], ("", "")

    def replace(line: re.Match[bytes]) -> bytes:
        """Replace names by numbers: trimesh joins names of groups, and is to read no materials."""
        nonlocal group
        key, value = line[1], " ".join(line[2].decode("utf-8", "replace").split())
        if key == b"mtllib":
            libraries.append(value)
        if key == b"usemtl":
            group = group[0], value
        elif key in (b"o", b"g") and by_name:
            group = value, group[1]
        else:
            return b""
        if numbers.setdefault(group, len(numbers)) > _MAX_OBJ_GROUPS:
            raise SceneError(f"more than {_MAX_OBJ_GROUPS:,} groups: join them in the original program")
        return b"usemtl %d" % numbers[group]

    text = b"mtllib names\nusemtl 0\n" + _OTHER_OBJ_LINE.sub(replace, text)
    needs_normals = b"/" not in text and len(numbers) * text.count(b"\nv ") > _MANY_OBJ_VISITS
    if needs_normals:
        text = re.sub(rb"(?m)^f .*", lambda face: b"f %b//1" % b"//1 ".join(face[0].split()[1:]), text)
        text = b"vn 0 0 1\n" + text
    names = "".join(f"newmtl {number}\n" for number in numbers.values())
    meshes = _load(obj.load_obj, io.StringIO(text.decode("ascii")), resolver={"names": names})
    if needs_normals:
        meshes = [{name: value for name, value in mesh.items() if name != "vertex_normals"} for mesh in meshes]
    groups = list(numbers)
    return {groups[int(mesh["visual"].material.name)]: mesh for mesh in reversed(meshes)}, libraries


def load_ply(content: bytes, **options: Any) -> TrimeshArrays:
    """Load the mesh in a PLY file. Raises SceneError if it is damaged or smaller than its header claims."""
    header = _PLY_HEADER.match(content)
    if header is None:
        raise SceneError("is not a PLY file with a whole header: export it again")
    size, rows = len(content) - header.end(), 0
    for name, count in re.findall(rb"(?m)^[ \t]*element[ \t]+(\S+)[ \t]+(\S+)", header[0]):
        if not count.isdigit() or len(count) > 18 or int(count) > size:
            raise SceneError(f"claims {_shown(count)} of '{_shown(name)}', more than it holds: copy or export it again")
        require_bounded(int(count))
        rows += int(count)
    if b"ascii" in header[0].lower().split(b"\n", 2)[1]:
        if size > MAX_TEXT_BYTES:
            raise SceneError(f"holds {size:,} bytes of text: save it as binary PLY")
        body = content[header.end() :]
        lines = body.rstrip().count(b"\n") + 1
        if rest := body.translate(None, b"-+.0123456789eE \t\r\n"):
            raise SceneError(f"'{_shown(rest)}' among its numbers: export it again")
        if lines != rows or body.count(b"\r") > lines:
            raise SceneError(f"claims {rows:,} rows and holds {lines:,}: copy or export it again")
    return _load(ply.load_ply, io.BytesIO(content), skip_materials=True, **options)[0]


def load_stl(content: bytes) -> list[TrimeshArrays]:
    """Load the solids in an STL file. Raises SceneError if it is damaged or not as large as its header claims."""
    (count,) = struct.unpack_from("<I", content.ljust(_STL_HEADER, b"\0"), _STL_HEADER - 4)
    if len(content) == _STL_HEADER + count * _STL_FACET:  # "solid" also begins many binary headers
        require_bounded(count)
        return _load(stl.load_stl_binary, io.BytesIO(content))
    if not content[:1000].lstrip().lower().startswith(b"solid"):
        raise SceneError(f"is neither text nor the {count:,} triangles that its header claims: copy or export it again")
    if len(content) > MAX_TEXT_BYTES or len(re.findall(rb"(?i)endsolid", content)) > _MAX_STL_SOLIDS:
        raise SceneError(f"holds more than {MAX_TEXT_BYTES:,} bytes of text or {_MAX_STL_SOLIDS:,} solids: save it as "
                         "binary STL")  # fmt: skip
    if bad := _BAD_STL_VERTEX.search(content):
        raise SceneError(f"'{_shown(bad[0])}' is not a vertex: export it again")
    if not re.search(rb"(?i)endsolid[^\n]*\s*$", content[-1000:]):
        raise SceneError("ends within a solid: copy or export it again")
    return _load(stl.load_stl_ascii, io.StringIO(content.decode("utf-8", "replace")))


def _load(loader: Callable[..., TrimeshArrays], stream: io.IOBase, **options: Any) -> list[TrimeshArrays]:
    try:
        loaded = loader(stream, **options)
        meshes = [mesh for mesh in loaded.get("geometry", {"": loaded}).values() if mesh.get("faces") is not None]
        for mesh in meshes:
            mesh["faces"] = triangulate_quads(mesh["faces"]).reshape(-1, 3)  # polygons of any size
            mesh["vertices"] = np.asarray(mesh["vertices"], np.float64)
    except Exception as error:  # loaders raise arbitrary errors for damaged content
        reason = one_line(" ".join(f"{error}".split()) or type(error).__name__, 80)
        raise SceneError(f"cannot be read ({reason}): export it again as triangles") from None
    meshes = [mesh for mesh in meshes if len(mesh["faces"])]
    if not meshes:
        raise SceneError("the mesh has no faces: export it with triangles")
    require_bounded(sum(len(mesh["faces"]) for mesh in meshes), len(meshes))
    if any(not 0 <= mesh["faces"].min() <= mesh["faces"].max() < len(mesh["vertices"]) for mesh in meshes):
        raise SceneError("a face refers to a vertex that does not exist: export it again")
    return meshes


def _shown(text: bytes) -> str:
    return one_line(" ".join(text[:400].decode("utf-8", "replace").split()), 60)

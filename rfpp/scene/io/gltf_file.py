"""Container of glTF: JSON, buffers and the arrays in them. Sizes are checked before anything is read."""

from __future__ import annotations

import base64
import struct
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.gltf_json import FLAG, INDEX, TEXT, Entry
from rfpp.scene.io.limits import MAX_BYTES, MAX_JSON_BYTES, MAX_TRIANGLES, beside, parse_json, read_bytes

#: Extensions that a file may require; all others would change its meaning. Transmission is refused where it is used.
_KNOWN = {"EXT_texture_webp", "KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_materials_ior",
          "KHR_materials_pbrSpecularGlossiness", "KHR_materials_specular", "KHR_materials_transmission",
          "KHR_materials_unlit", "KHR_materials_variants", "KHR_materials_volume", "KHR_mesh_quantization",
          "KHR_texture_transform"}  # fmt: skip
_COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
_ENVIRONMENTS = {"EXT_lights_image_based", "KHR_lights_environment", "EXT_lights_ies"}
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: Limit of elements of all arrays: positions, normals, two sets of coordinates and colors, and indices.
_MAX_ELEMENTS = 20 * MAX_TRIANGLES


class GltfFile:
    """A .gltf or .glb file; buffers are read when they are needed. Every method raises SceneError without its name."""

    def __init__(self, text: bytes, chunk: bytes | None, folder: Path | None) -> None:
        self._folder, self._chunk = folder, chunk
        self.document = Entry(parse_json(text, "glTF 2.0"))
        self._buffers: dict[int, bytes] = {}
        self._elements = 0
        version = self.document.entry("asset").get("version", TEXT, "")
        if version.split(".")[0] != "2":
            raise SceneError(f"glTF version '{one_line(version)}' cannot be read: export glTF 2.0")
        required = {str(name) for name in self.document.items("extensionsRequired")}
        if _ENVIRONMENTS & {*required, *map(str, self.document.items("extensionsUsed"))}:
            raise SceneError("light of an environment cannot be represented: use lights or emissive surfaces instead")
        if unknown := required - _KNOWN:
            name = one_line(min(unknown), 80)
            fix = "decompress it with npx @gltf-transform/cli copy" if name in _COMPRESSED else "export it without"
            raise SceneError(f"needs {name}, which cannot be read: {fix}")

    @classmethod
    def at(cls, path: Path) -> GltfFile:
        """Open a file by its suffix."""
        if path.suffix.lower() == ".glb":
            return cls(*_split(read_bytes(path)), path.parent)
        return cls(read_bytes(path, MAX_JSON_BYTES, "export it as .glb"), None, path.parent)

    @classmethod
    def received(cls, content: bytes) -> GltfFile:
        """Open a GLB file that came without a folder."""
        return cls(*_split(content), None)

    def linked(self, entry: Entry, key: str, name: str) -> Entry | None:
        """Return the object in the document's list `name` that an entry refers to; None without a reference."""
        return self.document.at(name, entry.get(key, INDEX)) if key in entry else None

    def array(self, index: int, *types: str) -> np.ndarray:
        """Return the elements of an accessor of one of these types, [count] or [count, width]; normalized as floats."""
        accessor = self.document.at("accessors", index)
        kind, component = accessor.get("type", TEXT, ""), accessor.get("componentType", INDEX, 0)
        if kind not in types or component not in _COMPONENTS:
            raise SceneError(f"{accessor.where}: {one_line(kind, 40)} of {component} where {' or '.join(types)} was "
                             "expected: export it again")  # fmt: skip
        view = self.linked(accessor, "bufferView", "bufferViews")
        if "sparse" in accessor or view is None:
            raise SceneError(f"{accessor.where}: sparse or empty accessors cannot be read: export it without them")
        content, dtype, width = self.view(view), np.dtype(_COMPONENTS[component]), _WIDTHS[kind]
        count, offset = accessor.get("count", INDEX, 0), accessor.get("byteOffset", INDEX, 0)
        stride = view.get("byteStride", INDEX, 0) or dtype.itemsize * width
        if count < 1 or offset + (count - 1) * stride + dtype.itemsize * width > len(content):
            raise SceneError(
                f"{accessor.where}: {count:,} elements are none or more than its bytes hold: export it again"
            )
        self._elements += count
        if self._elements > _MAX_ELEMENTS:
            raise SceneError(f"its meshes have more than {_MAX_ELEMENTS:,} elements: decimate the meshes")
        values = np.ndarray((count, width), dtype, content, offset, (stride, dtype.itemsize)).copy()
        values = values if width > 1 else values[:, 0]
        if accessor.get("normalized", FLAG, False) and dtype.kind != "f":
            return np.maximum(values / np.float64(np.iinfo(dtype).max), -1.0)
        return values

    def view(self, view: Entry) -> memoryview:
        """Return the bytes of a buffer view."""
        begin = view.get("byteOffset", INDEX, 0)
        end = begin + view.get("byteLength", INDEX, 0)
        content = self._buffer(view.get("buffer", INDEX, 0))
        if end > len(content):
            raise SceneError(
                f"a buffer view ends at byte {end:,} of {len(content):,}: the file is truncated or damaged"
            )
        return memoryview(content)[begin:end]

    def bytes_of(self, uri: str) -> bytes:
        """Return the content of a data URI, or of a file beside this one."""
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(";base64,")[2], validate=True)
            except ValueError:
                raise SceneError("a data URI is not base64: export it again") from None
        if self._folder is None:
            raise SceneError(f"names the file '{one_line(uri, 60)}', which did not come with it: put it inside")
        path = beside(self._folder, unquote(uri))
        try:
            return read_bytes(path)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            entry = self.document.at("buffers", index)
            is_chunk = index == 0 and self._chunk is not None and "uri" not in entry
            content = self._chunk if is_chunk else self.bytes_of(entry.get("uri", TEXT, "data:"))
            claimed = entry.get("byteLength", INDEX, 0)
            if len(content) < claimed:
                raise SceneError(
                    f"{entry.where}: {len(content):,} of {claimed:,} bytes are there: copy or export it again"
                )
            if sum(map(len, self._buffers.values())) + len(content) > MAX_BYTES:
                raise SceneError(f"its buffers hold more than {MAX_BYTES:,} bytes: make it smaller")
            self._buffers[index] = content
        return self._buffers[index]


def _split(content: bytes) -> tuple[bytes, bytes | None]:
    if content[:4] != b"glTF" or len(content) < 20:
        raise SceneError("is not a GLB file: export it again")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2 or length > len(content):
        raise SceneError(
            f"is truncated or not glTF 2.0 ({len(content):,} of {length:,} bytes): copy or export it again"
        )
    chunks, position = {}, 12
    while position + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, position)
        chunks.setdefault(kind, content[position + 8 : position + 8 + size])
        position += 8 + size
    if not 0 < len(chunks.get(b"JSON", b"")) <= MAX_JSON_BYTES:
        raise SceneError(f"holds no JSON, or more than {MAX_JSON_BYTES:,} bytes of it: export it again")
    return chunks[b"JSON"], chunks.get(b"BIN\0")

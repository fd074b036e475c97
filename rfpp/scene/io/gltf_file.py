"""The container of glTF: JSON, buffers and the arrays in them. Nothing is read that the file does not really hold."""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar
from urllib.parse import unquote

import numpy as np

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.gltf_schema import BufferView, Document, parse_document
from rfpp.scene.io.limits import (
    MAX_BYTES,
    MAX_JSON_BYTES,
    MAX_TRIANGLES,
    beside,
    parse_json,
    read_bytes,
)

Entry = TypeVar("Entry")

#: Extensions that a file may require; all others would change what it means.
_KNOWN = {
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",  # known, and refused where it transmits anything
    "KHR_materials_volume",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}
_REMEDIES = {
    "KHR_draco_mesh_compression": "export it without mesh compression",
    "EXT_meshopt_compression": "export it without mesh compression",
    "KHR_meshopt_compression": "export it without mesh compression",
    "KHR_texture_basisu": "export it with PNG, JPEG or WebP textures",
    "EXT_mesh_gpu_instancing": "export its instances as nodes",
}
_ENVIRONMENTS = ("EXT_lights_image_based", "KHR_lights_environment", "EXT_lights_ies")

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: Of all arrays that are read: positions, normals, two sets of coordinates and colours, and indices.
_MAX_ELEMENTS = 20 * MAX_TRIANGLES
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class GltfFile:
    """A .gltf or .glb file whose document is valid; buffers are read when they are asked for.

    Attributes:
        folder: where the files lie that it names; None: it may name none.
        document: its JSON.

    Args:
        text: the JSON, not yet read.
        chunk: the binary chunk of a GLB file, if there is one.

    Raises:
        SceneError: without the file's name; also from every method.
    """

    def __init__(self, text: bytes, chunk: bytes | memoryview | None, folder: Path | None) -> None:
        self.folder, self._chunk = folder, chunk
        self.document: Document = parse_document(parse_json(text, "glTF 2.0"))
        self._buffers: dict[int, bytes | memoryview] = {}
        self._elements = 0
        self._require_known_extensions()

    @classmethod
    def at(cls, path: Path) -> GltfFile:
        """By its suffix."""
        if path.suffix.lower() == ".glb":
            return cls(*_split(read_bytes(path)), path.parent)
        return cls(read_bytes(path, MAX_JSON_BYTES, "export it as .glb"), None, path.parent)

    @classmethod
    def received(cls, content: bytes) -> GltfFile:
        """A GLB file that came without a folder."""
        return cls(*_split(content), None)

    def entry(self, entries: Sequence[Entry], index: int, name: str) -> Entry:
        """`entries[index]`, of the document's list of that name."""
        if index >= len(entries):
            raise SceneError(f"{name}.{index} is referred to and does not exist: export it again")
        return entries[index]

    def array(self, index: int, *types: str) -> np.ndarray:
        """[count] or [count, width]: the elements of an accessor of one of these types; normalised ones as floats."""
        accessor = self.entry(self.document.accessors, index, "accessors")
        where = f"accessors.{index}"
        if accessor.type not in types or accessor.component_type not in _COMPONENTS:
            raise SceneError(f"{where}: {one_line(accessor.type)} of {accessor.component_type} where "
                             f"{' or '.join(types)} was expected: export it again")  # fmt: skip
        if accessor.sparse is not None or accessor.buffer_view is None:
            raise SceneError(f"{where}: sparse or empty accessors cannot be read: export it without them")
        view = self.entry(self.document.buffer_views, accessor.buffer_view, "bufferViews")
        dtype, width = np.dtype(_COMPONENTS[accessor.component_type]), _WIDTHS[accessor.type]
        size = dtype.itemsize * width
        stride = view.byte_stride or size
        claimed = accessor.byte_offset + (accessor.count - 1) * stride + size
        if claimed > view.byte_length:
            raise SceneError(f"{where}: {accessor.count:,} elements are claimed, more than its bytes hold: "
                             "export it again")  # fmt: skip
        _require_reasonable(accessor.count, where)
        self._elements += accessor.count
        if self._elements > _MAX_ELEMENTS:
            raise SceneError(f"its meshes are made of more than {_MAX_ELEMENTS:,} elements, of which some may be read "
                             "many times: decimate the meshes")  # fmt: skip
        elements = np.ndarray(
            (accessor.count, width), dtype, self.view(view), accessor.byte_offset, (stride, dtype.itemsize)
        )
        values = elements.copy() if width > 1 else elements[:, 0].copy()
        return _normalised(values) if accessor.normalized and dtype.kind != "f" else values

    def view(self, view: BufferView) -> memoryview:
        """The bytes of a buffer view."""
        end = view.byte_offset + view.byte_length
        buffer = self._buffer(view.buffer)
        if end > len(buffer):
            raise SceneError(f"a buffer view ends at byte {end:,} of {len(buffer):,}: the file is truncated or damaged")
        return memoryview(buffer)[view.byte_offset : end]

    def bytes_of(self, uri: str) -> bytes:
        """Of a data URI, or of a file beside this one."""
        if uri[:5].lower() == "data:":
            header, comma, encoded = uri.partition(",")
            try:
                if not comma or not header.endswith(";base64"):
                    raise ValueError
                return base64.b64decode(encoded, validate=True)
            except (binascii.Error, ValueError):
                raise SceneError("a data URI is not base64: export it again") from None
        if self.folder is None:
            raise SceneError(f"names the file '{one_line(uri, 60)}', which did not come with it: put it inside")
        path = beside(self.folder, unquote(uri))
        try:
            return read_bytes(path)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None

    def require_sound_buffers(self) -> None:
        """For readers that trust what the document says: every buffer whole, every claim of elements within reason."""
        for index in range(len(self.document.buffers)):
            self._buffer(index)
        for index, accessor in enumerate(self.document.accessors):
            _require_reasonable(accessor.count, f"accessors.{index}")
            if accessor.sparse is None and accessor.buffer_view is not None and accessor.type in _WIDTHS:
                self.array(index, accessor.type)

    def _buffer(self, index: int) -> bytes | memoryview:
        if index not in self._buffers:
            entry = self.entry(self.document.buffers, index, "buffers")
            if entry.uri is None and (self._chunk is None or index > 0):
                raise SceneError(f"buffers.{index} has no content: export it again")
            content = self._chunk if entry.uri is None else self.bytes_of(entry.uri)
            if len(content) < entry.byte_length:
                raise SceneError(f"buffers.{index}: {len(content):,} of {entry.byte_length:,} bytes are there: "
                                 "copy or export it again")  # fmt: skip
            if sum(map(len, self._buffers.values())) + len(content) > MAX_BYTES:
                raise SceneError(f"its buffers hold more than {MAX_BYTES:,} bytes: make it smaller")
            self._buffers[index] = content
        return self._buffers[index]

    def _require_known_extensions(self) -> None:
        required, used = self.document.extensions_required, self.document.extensions_used
        for name in (*required, *used):
            if name in _ENVIRONMENTS:
                raise SceneError(f"{name}: light of an environment cannot be represented: use lights or emissive "
                                 "surfaces in its place")  # fmt: skip
        for name in required:
            if name not in _KNOWN:
                name = one_line(name, 80)
                raise SceneError(f"needs {name}, which cannot be read: {_REMEDIES.get(name, 'export it without')}")


def _require_reasonable(elements: int, where: str) -> None:
    if elements > 3 * MAX_TRIANGLES:
        raise SceneError(f"{where}: {elements:,} elements are more than {3 * MAX_TRIANGLES:,}: decimate the meshes")


def _split(content: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON and the binary chunk of a GLB file."""
    if content[:4] != b"glTF" or len(content) < 20:
        raise SceneError("is not a GLB file: export it again")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2:
        raise SceneError(f"GLB version {version} cannot be read: export glTF 2.0")
    if length > len(content):
        raise SceneError(f"is truncated, {len(content):,} of {length:,} bytes are there: copy it again")
    chunks: dict[int, memoryview] = {}
    position = 12
    while position + 8 <= length:
        size, kind = struct.unpack_from("<II", content, position)
        position += 8
        if position + size > length:
            raise SceneError("a chunk ends beyond the file: copy or export it again")
        chunks.setdefault(kind, memoryview(content)[position : position + size])
        position += size
    if len(chunks.get(_JSON_CHUNK, b"")) > MAX_JSON_BYTES:
        raise SceneError(f"its JSON is larger than {MAX_JSON_BYTES:,} bytes: make it smaller")
    if _JSON_CHUNK not in chunks:
        raise SceneError("holds no JSON: export it again")
    return bytes(chunks[_JSON_CHUNK]), chunks.get(_BINARY_CHUNK)


def _normalised(values: np.ndarray) -> np.ndarray:
    return np.maximum(values / np.float64(np.iinfo(values.dtype).max), -1.0)

"""Writer of GLB files."""

from __future__ import annotations

import json
import struct
import zlib

import numpy as np

#: Column-major matrix from Blender's world, Z up, to glTF's, Y up.
Z_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]
_FLOAT, _UNSIGNED = 5126, 5125
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class Glb:
    """A file with one scene, whose nodes are in Blender's coordinates."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._length = 0
        self._lists: dict[str, list[dict]] = {"nodes": []}
        self._lights: list[dict] = []

    def add(self, kind: str, entry: dict) -> int:
        """Append an entry to a list of the document, and return its index."""
        entries = self._lists.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def array(self, values: np.ndarray) -> int:
        """Add floats or indices [n] or [n, width], and return the accessor."""
        is_float = values.dtype.kind == "f"
        content = np.ascontiguousarray(values, "<f4" if is_float else "<u4")
        entry = {
            "bufferView": self._view(content.tobytes()),
            "componentType": _FLOAT if is_float else _UNSIGNED,
            "count": len(content),
            "type": _TYPES[content.shape[1] if content.ndim > 1 else 1],
        }
        if entry["type"] == "VEC3":  # required for positions
            entry |= {"min": content.min(axis=0).tolist(), "max": content.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def texture(self, png: bytes) -> int:
        """Add a repeating texture, and return its index."""
        image = self.add("images", {"bufferView": self._view(png), "mimeType": "image/png"})
        return self.add("textures", {"source": image})

    def light(self, entry: dict) -> dict:
        """Add a light (KHR_lights_punctual), and return the extensions of its node."""
        self._lights.append(entry)
        return {"KHR_lights_punctual": {"light": len(self._lights) - 1}}

    def node(self, name: str, matrix: np.ndarray, **values: object) -> None:
        """Add a node with its matrix [4, 4] to Blender's world, and a mesh, a camera or extensions."""
        columns = np.asarray(matrix, np.float64).T.reshape(-1).tolist()
        self.add("nodes", {"name": name, "matrix": columns, **values})

    def content(self) -> bytes:
        """Return the file."""
        nodes = self._lists["nodes"]
        root = {"name": "z_up", "matrix": Z_UP, "children": list(range(len(nodes)))}
        document = {"asset": {"version": "2.0"}, **self._lists, "nodes": [*nodes, root]}
        document |= {"scenes": [{"nodes": [len(nodes)]}], "scene": 0, "buffers": [{"byteLength": self._length}]}
        if self._lights:
            document |= {"extensionsUsed": ["KHR_lights_punctual"]}
            document |= {"extensions": {"KHR_lights_punctual": {"lights": self._lights}}}
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary = b"".join(self._chunks)
        parts = [struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary]
        return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, parts))) + b"".join(parts)

    def _view(self, content: bytes) -> int:
        view = {"buffer": 0, "byteOffset": self._length, "byteLength": len(content)}
        self._chunks.append(content + bytes(-len(content) % 4))
        self._length += len(self._chunks[-1])
        return self.add("bufferViews", view)


def png(pixels: np.ndarray) -> bytes:
    """Encode 8-bit RGBA pixels [h, w, 4], row 0 at the top."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # a leading 0 means no filter
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">2I5B", width, height, 8, 6, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )

"""glTF files, put together array by array."""

import base64
import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (16,): "MAT4"}

#: A square of side 1 in glTF's floor plane, facing up (+Y), as positions and indices.
SQUARE = (
    np.array([[-0.5, 0, 0.5], [0.5, 0, 0.5], [0.5, 0, -0.5], [-0.5, 0, -0.5]]),
    np.array([0, 1, 2, 0, 2, 3]),
)
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])


class GltfBuilder:
    """`document` is the JSON, to be changed at will before it is written."""

    def __init__(self) -> None:
        self.binary = b""
        self.document: dict = {"asset": {"version": "2.0"}}

    def add(self, kind: str, entry: dict) -> int:
        entries = self.document.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def view(self, content: bytes) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.binary += content
        return self.add("bufferViews", view)

    def accessor(self, array: np.ndarray, dtype: str = "f4", **values: object) -> int:
        array = np.asarray(array).astype(f"<{dtype}")
        entry = {
            "bufferView": self.view(array.tobytes()),
            "componentType": _COMPONENTS[dtype],
            "count": len(array),
            "type": _TYPES[array.shape[1:]],
        }
        return self.add("accessors", entry | values)

    def primitive(self, positions=SQUARE[0], indices=SQUARE[1], material=None, attributes=None, **values) -> dict:
        entry = {"attributes": {"POSITION": self.accessor(positions), **(attributes or {})}, **values}
        if indices is not None:
            entry["indices"] = self.accessor(indices, "u2")
        if material is not None:
            entry["material"] = self.add("materials", material)
        return entry

    def node(self, *primitives: dict, **values: object) -> int:
        """Its mesh is made of the primitives."""
        if primitives:
            values["mesh"] = self.add("meshes", {"primitives": list(primitives)})
        return self.add("nodes", values)

    def texture(self, pixels: np.ndarray) -> dict:
        """A reference to a PNG of these 8-bit pixels."""
        content = io.BytesIO()
        Image.fromarray(pixels.astype(np.uint8)).save(content, "PNG")
        image = self.add("images", {"bufferView": self.view(content.getvalue()), "mimeType": "image/png"})
        return {"index": self.add("textures", {"source": image})}

    def glb(self) -> bytes:
        self.document["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.document).encode()
        chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", self.binary + bytes(-len(self.binary) % 4))]
        body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in chunks)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    def gltf(self, uri: str | None = None) -> bytes:
        """Return a glTF file with its buffer in a data URI or at `uri`."""
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        self.document["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
        return json.dumps(self.document).encode()

    def write(self, folder: Path, name: str = "scene.glb") -> Path:
        path = folder / name
        path.write_bytes(self.glb() if path.suffix == ".glb" else self.gltf())
        return path

"""What a mesh file must hold true before a library that trusts it may read it."""

from __future__ import annotations

from pathlib import Path

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.limits import read_bytes
from rfpp.scene.io.ply_file import read_header
from rfpp.scene.io.stl import require_whole_stl


def require_sound(path: Path) -> None:
    """Raises SceneError naming the file: empty, larger than is read, with absurd claims, or naming files elsewhere.

    Our own reader of OBJ files trusts nothing, so they need none of this.
    """
    try:
        match path.suffix.lower():
            case ".gltf" | ".glb":
                GltfFile.at(path).require_sound_buffers()
            case ".ply":
                read_header(read_bytes(path))
            case ".stl":
                require_whole_stl(read_bytes(path))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None

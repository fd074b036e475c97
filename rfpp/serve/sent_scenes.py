"""Scenes that were sent, by name."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError
from rfpp.inference.bounded_cache import BoundedCache
from rfpp.scene.io.fitting import fitted
from rfpp.scene.io.framing import Framing
from rfpp.scene.io.gltf import received_glb
from rfpp.scene.packed import PackedScene, pack

#: What notes call a scene that has no file.
_SOURCE = Path("scene")


@dataclass(frozen=True, eq=False)
class Received:
    """A scene as it is rendered.

    Attributes:
        name: a digest of what was sent.
        scene: in the coordinates of training scenes; its cameras do not matter.
        framing: what brought it there.
        notes: how it differs from what was sent, a line each.
    """

    name: str
    scene: PackedScene
    framing: Framing
    notes: tuple[str, ...]

    @classmethod
    def of(cls, content: bytes) -> Received:
        """From a GLB file, like `load_scene` of the same file. Not for several threads at a time.

        Raises SceneError: it is damaged, too large, or cannot be represented.
        """
        with warnings.catch_warnings(record=True) as said, np.errstate(over="ignore", invalid="ignore"):
            warnings.simplefilter("always")
            made = fitted(received_glb(content, _SOURCE), _SOURCE, "opaque", "none")
            packed = pack(made.scene)
        notes = (str(warning.message) for warning in said if warning.category is UserWarning)
        return cls(_named(content), packed, made.framing, tuple(note.removeprefix(f"{_SOURCE}: ") for note in notes))

    @property
    def bytes(self) -> int:
        """Of its arrays."""
        triangles = self.scene.triangles
        return sum(array.nbytes for array in (triangles.positions, triangles.normals, triangles.material))


class ReceivedScenes:
    """The scenes that were asked for last.

    Args:
        max_bytes: of their arrays.
    """

    def __init__(self, max_bytes: int = 1 << 30) -> None:
        self._kept: BoundedCache[Received] = BoundedCache(max_bytes)

    def add(self, content: bytes) -> Received:
        """A GLB file, read unless it is there. Raises like `Received.of`, and SceneError for one too large to keep."""
        name = _named(content)
        if (known := self._kept.get(name)) is not None:
            return known
        received = Received.of(content)
        self._kept.put(name, received, received.bytes)
        if self._kept.get(name) is None:
            raise SceneError(f"{received.bytes:,} bytes of triangles are more than are kept: decimate the meshes")
        return received

    def get(self, name: str) -> Received | None:
        """None for one that never came or was forgotten."""
        return self._kept.get(name)


def _named(content: bytes) -> str:
    return blake2b(content, digest_size=16).hexdigest()

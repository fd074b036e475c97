"""Render scenes that clients have sent."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError, UserError
from rfpp.inference.bounded_cache import BoundedCache
from rfpp.inference.renderer import Renderer
from rfpp.raycast.first_hit import first_hit
from rfpp.scene.io.fitting import fitted
from rfpp.scene.io.framing import Framing
from rfpp.scene.io.gltf import received_glb
from rfpp.scene.packed import PackedScene, pack
from rfpp.serve.image_window import ImageWindow
from rfpp.serve.render_request import RenderRequest

#: Name of a scene without a file in warnings.
_SOURCE = Path("scene")


class UnknownSceneError(UserError):
    """A scene that was never sent, or has left the cache."""


@dataclass(frozen=True, eq=False)
class ReceivedScene:
    """A scene in the coordinates of training scenes; its cameras are not used."""

    name: str  # digest of the file
    scene: PackedScene
    framing: Framing  # transform from the coordinates of the file
    notes: tuple[str, ...]  # changes made to the scene, one line each

    @classmethod
    def read(cls, content: bytes) -> ReceivedScene:
        """Read a GLB file as `load_scene` does, one at a time. Raises SceneError if it is invalid or too large."""
        with warnings.catch_warnings(record=True) as caught, np.errstate(over="ignore", invalid="ignore"):
            warnings.simplefilter("always")
            fit = fitted(received_glb(content, _SOURCE), _SOURCE, "opaque", "none")
            packed = pack(fit.scene)
        messages = [str(w.message).removeprefix(f"{_SOURCE}: ") for w in caught if w.category is UserWarning]
        notes = tuple(message for message in messages if "no camera" not in message)  # requests have one
        return cls(_name(content), packed, fit.framing, notes)


class SceneRenderer:
    """Renders scenes that were sent, and caches the latest of them, up to `max_bytes` of triangles."""

    def __init__(self, renderer: Renderer, max_bytes: int = 1 << 30) -> None:
        self.renderer = renderer
        self._scenes: BoundedCache[ReceivedScene] = BoundedCache(max_bytes)

    def receive(self, content: bytes) -> ReceivedScene:
        """Read a GLB file, unless the cache has it. Raises SceneError if it is invalid, or larger than the cache."""
        name = _name(content)
        received = self._scenes.get(name) or ReceivedScene.read(content)
        triangles = received.scene.triangles
        size = triangles.positions.nbytes + triangles.normals.nbytes + triangles.material.nbytes
        self._scenes.put(name, received, size)
        if self._scenes.get(name) is None:
            raise SceneError(f"{size:,} bytes of triangles do not fit into the server's cache: decimate the meshes")
        return received

    def render(self, request: RenderRequest) -> Float[np.ndarray, "h w 4"]:
        """Return linear radiance and alpha, row 0 at the top. Raises UserError, UnknownSceneError among them."""
        if (received := self._scenes.get(request.scene)) is None:
            raise UnknownSceneError("unknown scene: send it first")
        window = ImageWindow.around(request.window, request.size, self.renderer.engine.patch_size)
        camera = received.framing.camera(request.camera(window.fov))
        scene = replace(received.scene.seen_by([camera]), name="scene")
        sampling = {"light_samples": request.light_samples, "supersampling": request.supersampling}
        [image] = self.renderer.render(scene, window.image_size, **sampling)
        alpha = _coverage(scene, *image.shape[:2], request.supersampling) if request.transparent else 1.0
        return window.crop(np.dstack([image, np.broadcast_to(alpha, image.shape[:2])]).astype(np.float32))


def _coverage(scene: PackedScene, height: int, width: int, points: int) -> Float[np.ndarray, "h w"]:
    hit = first_hit(scene.triangles, scene.c2w[0], scene.fov[0], points * height, points * width).hit
    return hit.reshape(height, points, width, points).mean(axis=(1, 3))


def _name(content: bytes) -> str:
    return blake2b(content, digest_size=16).hexdigest()

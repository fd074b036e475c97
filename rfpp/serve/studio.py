"""One renderer for everyone who asks, one picture at a time; who left before their turn is passed over."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from rfpp.inference.renderer import Renderer
from rfpp.raycast.first_hit import first_hit
from rfpp.scene.packed import PackedScene
from rfpp.serve.image_window import Frame
from rfpp.serve.render_request import Asked
from rfpp.serve.sent_scenes import Received, ReceivedScenes

#: Seconds after which one who waits is looked after.
_GLANCE = 0.1


class Left(Exception):  # noqa: N818 (no error)
    """Whoever asked does not wait any longer."""


class UnknownScene(Exception):  # noqa: N818
    """The scene never came, or was forgotten: send it again."""


class Studio:
    """Renders scenes that were sent.

    Args:
        renderer: its caches make an edit or another view cost what changed.
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer, self.scenes = renderer, ReceivedScenes()
        self._turn = threading.Lock()

    def receive(self, content: bytes, has_left: Callable[[], bool]) -> Received:
        """A scene in a GLB file. Raises SceneError, see `Received.of`, and Left."""
        with self._my_turn(has_left):
            return self.scenes.add(content)

    def picture(self, asked: Asked, has_left: Callable[[], bool]) -> Float[np.ndarray, "h w 4"]:
        """Linear radiance and alpha, row 0 at the top.

        Args:
            asked: for what.
            has_left: whether nobody waits for it any longer; asked while it waits for its turn.

        Raises:
            UnknownScene, Left.
            UserError: see `Renderer.render` and `Frame.around`.
        """
        if (received := self.scenes.get(asked.scene)) is None:
            raise UnknownScene
        frame = Frame.around(asked.window, asked.size, self.renderer.engine.patch_size)
        camera = received.framing.camera(asked.camera(frame.fov))
        seen = replace(received.scene.seen_by([camera]), name="scene")
        with self._my_turn(has_left):
            [image] = self.renderer.render(
                seen, frame.size, light_samples=asked.light_samples, supersampling=asked.supersampling
            )
            alpha = _coverage(seen, frame, asked.supersampling) if asked.transparent else np.ones(image.shape[:2])
        return frame.cut(np.concatenate([image, alpha[..., None]], axis=-1).astype(np.float32))

    @contextmanager
    def _my_turn(self, has_left: Callable[[], bool]) -> Iterator[None]:
        while not self._turn.acquire(timeout=_GLANCE):
            if has_left():
                raise Left
        try:
            if has_left():
                raise Left
            yield
        finally:
            self._turn.release()


def _coverage(scene: PackedScene, frame: Frame, points: int) -> Float[np.ndarray, "h w"]:
    """The share of each pixel in which a surface is seen."""
    height, width = frame.size
    seen = first_hit(scene.triangles, scene.c2w[0], scene.fov[0], points * height, points * width).triangle >= 0
    return seen.reshape(height, points, width, points).mean(axis=(1, 3))

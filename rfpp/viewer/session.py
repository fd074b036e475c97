"""A visitor's session: scene, camera, and a thread that redraws on changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import UInt8

from rfpp.errors import UserError
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene
from rfpp.viewer.comparison import Comparison, enlarged
from rfpp.viewer.layers import Layer
from rfpp.viewer.pacing import Pacing
from rfpp.viewer.reference import Reference

Picture = UInt8[np.ndarray, "h w 3"]

#: Seconds without a change after which the image is drawn at its full size.
_AT_REST_AFTER = 0.2


@dataclass(frozen=True, eq=False)
class View:
    """Everything a picture depends on.

    Attributes:
        scene: with the visitor's edits; its cameras do not matter.
        camera: theirs.
        aspect: width / height of their window.
        layer: what of the scene.
        tone_map: of the picture.
        longer_side: pixels at rest.
        reference: path-traced earlier, if there is one.
        comparison: with it, if it is of this view.
        share: of the window that belongs to the picture, where it is compared.
    """

    scene: Scene | PackedScene
    camera: Camera
    aspect: float
    layer: Layer
    tone_map: ToneMap
    longer_side: int
    reference: Reference | None = None
    comparison: Comparison | None = None
    share: float = 0.5


@dataclass(frozen=True)
class Drawn:
    """A finished picture.

    Attributes:
        picture: 8-bit picture.
        rendered: (height, width) of the rendered image.
        seconds: Time from scene to picture.
        compared: Whether the picture contains the reference.
    """

    picture: Picture
    rendered: tuple[int, int]
    seconds: float
    compared: bool


class Session:
    """Draws the newest view of one visitor: small and as a draft while it changes, in full once it rests.

    Args:
        renderer: shared by all visitors.
        turn: a lock, so that they render one after another.
        view: to begin with.
        show: called with each picture, from the session's thread.
        complain: called with one line where a view cannot be drawn.
        moving_seconds: an image in motion may take.
    """

    def __init__(
        self,
        renderer: Renderer,
        turn: threading.Lock,
        view: View,
        show: Callable[[Drawn], None],
        complain: Callable[[str], None],
        moving_seconds: float | int,
    ):
        self.renderer, self._turn, self._show, self._complain = renderer, turn, show, complain
        self.pacing = Pacing(renderer.engine.patch_size, moving_seconds)
        self._view, self._closed = view, False
        self._changed = threading.Condition()
        self._packed: tuple[Scene | PackedScene, PackedScene] | None = None
        self._thread = threading.Thread(target=self._draw_on, name="viewer session", daemon=True)
        self._thread.start()

    @property
    def view(self) -> View:
        """The newest."""
        return self._view

    def change(self, **values: object) -> None:
        """Parts of the view."""
        with self._changed:
            self._view = replace(self._view, **values)
            self._changed.notify()

    def close(self) -> None:
        """End the thread, after the picture it is at."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def packed(self, view: View) -> PackedScene:
        """The view's scene, seen by its camera alone."""
        if self._packed is None or self._packed[0] is not view.scene:
            self._packed = view.scene, pack(view.scene)
        return self._packed[1].seen_by([view.camera])

    def _draw_on(self) -> None:
        drawn, better = None, False
        while (view := self._wanted(drawn, better)) is not None:
            full = size = self.pacing.size(view.longer_side, view.aspect)
            layer = view.layer
            try:
                if view is not drawn and not layer.at_once(self.packed(view), full):
                    size, layer = self.pacing.moving_size(view.longer_side, view.aspect), layer.in_motion
                self._show(self._draw(view, layer, size, full))
            except UserError as error:
                self._complain(str(error))
            drawn, better = view, size != full or layer != view.layer

    def _wanted(self, drawn: View | None, better: bool) -> View | None:
        """The next to be drawn: a new one, or, once it rests, one that can be drawn better. None: the visitor left."""
        with self._changed:
            rest = _AT_REST_AFTER if better else None
            self._changed.wait_for(lambda: self._closed or self._view is not drawn, rest)
            return None if self._closed else self._view

    def _draw(self, view: View, layer: Layer, size: tuple[int, int], full: tuple[int, int]) -> Drawn:
        with self._turn:
            begin = time.perf_counter()
            scene = self.packed(view)
            at_once = layer.at_once(scene, size)
            picture = layer.picture(scene, size, view.tone_map)
            seconds = time.perf_counter() - begin
        if not at_once and layer == layer.in_motion:  # others say nothing of what the next one in motion takes
            self.pacing.took(size, seconds)
        compared = bool(view.comparison and view.reference and view.reference.shows(view.scene, view.camera, full))
        if compared:
            reference = view.tone_map(view.reference.radiance)
            picture = view.comparison(enlarged(picture, full), reference, view.share)
        return Drawn(picture, size, seconds, compared)

"""A visitor's session: scene, camera, and a thread that redraws on changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from rfpp.errors import UserError
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.references import path_traced
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene
from rfpp.viewer.layers import Layer
from rfpp.viewer.pacing import Pacing

Picture = UInt8[np.ndarray, "h w 3"]

#: Seconds without a change until the picture is drawn in full.
_REST = 0.2


@dataclass(frozen=True, eq=False)
class Reference:
    """A path-traced image (linear radiance) of a scene, and its render time."""

    radiance: Float[np.ndarray, "h w 3"]
    seconds: float
    scene: Scene | PackedScene
    camera: Camera

    def shows(self, scene: Scene | PackedScene, camera: Camera, size: tuple[int, int]) -> bool:
        """Return whether it is an image of this view."""
        return self.scene is scene and self.camera == camera and self.radiance.shape[:2] == size


def path_trace(
    scene: Scene | PackedScene, camera: Camera, size: tuple[int, int], settings: CyclesSettings
) -> Reference:
    """Path-trace (height, width) pixels. Raises UserError if Blender is missing or cannot render the scene."""
    [([radiance], seconds)] = path_traced([pack(scene).seen_by([camera])], size, settings)
    return Reference(radiance, seconds, scene, camera)


@dataclass(frozen=True, eq=False)
class View:
    """Inputs of a picture: the scene with the visitor's edits, and the visitor's settings."""

    scene: Scene | PackedScene
    camera: Camera
    aspect: float  # width / height of the window
    layer: Layer
    tone_map: ToneMap
    longer_side: int  # pixels at rest
    reference: Reference | None = None  # shown if it is of this view
    share: float = 0.5  # of the picture beside the reference, from the left


@dataclass(frozen=True)
class Drawn:
    """A finished picture, and the size of the rendered image in it."""

    picture: Picture
    rendered: tuple[int, int]
    seconds: float
    is_compared: bool  # with the reference


class Session:
    """Drawing of one visitor's newest view: a small draft while it changes, in full once it rests.

    Args:
        view: First view; the attribute `view` is the newest, `newest` its picture.
        pacing: Resolutions at rest and in motion.
        lock: Lock of the renderer, shared by all visitors.
        report: Receives one line if a view cannot be drawn.
    """

    def __init__(self, view: View, pacing: Pacing, lock: threading.Lock, report: Callable[[str], None]):
        self._lock, self._report, self.pacing = lock, report, pacing
        self.view, self.newest, self._is_closed = view, None, False
        self._changed = threading.Condition()
        self._packed: tuple[Scene | PackedScene, PackedScene] | None = None
        self._callbacks: list[Callable[[Drawn], None]] = []
        self._thread = threading.Thread(target=self._run, name="viewer session", daemon=True)

    def on_draw(self, callback: Callable[[Drawn], None]) -> None:
        """Call back for each picture, in the session's thread."""
        self._callbacks.append(callback)

    def start(self) -> None:
        """Start drawing."""
        self._thread.start()

    def change(self, **values: object) -> None:
        """Change parts of the view."""
        with self._changed:
            self.view = replace(self.view, **values)
            self._changed.notify()

    def close(self) -> None:
        """Stop the thread after its current picture."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def _run(self) -> None:
        drawn, is_draft = None, False
        while (view := self._next(drawn, is_draft)) is not None:
            full = size = self.pacing.size(view.longer_side, view.aspect)
            try:
                scene = self._pack(view)
                is_draft = view is not drawn and not view.layer.is_instant(scene, full)
                if is_draft:
                    size = self.pacing.moving_size(view.longer_side, view.aspect)
                    is_draft = size != full or view.layer.has_drafts
                self.newest = self._draw(view, scene, size, full, is_draft)
                for callback in self._callbacks:
                    callback(self.newest)
            except UserError as error:
                is_draft = False
                self._report(str(error))
            drawn = view

    def _next(self, drawn: View | None, is_draft: bool) -> View | None:
        """Wait for a new view, or for a draft to rest; None when the session is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_closed or self.view is not drawn, _REST if is_draft else None)
            return None if self._is_closed else self.view

    def _pack(self, view: View) -> PackedScene:
        if self._packed is None or self._packed[0] is not view.scene:
            self._packed = view.scene, pack(view.scene)
        return self._packed[1].seen_by([view.camera])

    def _draw(
        self, view: View, scene: PackedScene, size: tuple[int, int], full: tuple[int, int], is_draft: bool
    ) -> Drawn:
        with self._lock:
            begin = time.perf_counter()
            is_instant = view.layer.is_instant(scene, size)
            picture = view.layer.picture(scene, size, view.tone_map, is_draft)
            seconds = time.perf_counter() - begin
        if not is_instant and is_draft >= view.layer.has_drafts:  # the cost of an image in motion
            self.pacing.record(size, seconds)
        reference = view.reference
        is_compared = bool(reference and view.share < 1 and reference.shows(view.scene, view.camera, full))
        if is_compared:
            picture = wiped(picture, view.tone_map(reference.radiance), view.share)
        return Drawn(picture, size, seconds, is_compared)


def wiped(picture: Picture, reference: Picture, share: float) -> Picture:
    """Return the picture, enlarged to the reference, left of a white line, and the reference right of it."""
    height, width = reference.shape[:2]
    enlarged = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST))
    edge = round(share * width)
    joined = np.concatenate([enlarged[:, :edge], reference[:, edge:]], axis=1)
    if 0 < edge < width:
        joined[:, edge] = 255
    return joined

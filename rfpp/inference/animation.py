"""Films: the frames of a motion, rendered and path-traced into folders, and the pictures of a video made from these."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from rfpp.imaging.panels import error_map
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.frame_folder import FrameFolder, Shot, digest, weights_digest
from rfpp.inference.overlapped_writing import written_beside
from rfpp.inference.references import path_traced
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flicker import flicker
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene

#: Called with (frames there, frames in all); see `rfpp.progress.counting`.
Show = Callable[[int, int], None]
Size = tuple[int, int]


class Film:
    """Frames of an animation, rendered and optionally path-traced, each into a folder.

    Args:
        frames: of a motion, each a PackedScene with one camera, made when it is asked for.
        folder: of the rendered frames; the path-traced ones are in `reference` below it.
        size: (height, width) in pixels.
    """

    def __init__(self, frames: Sequence, folder: Path, size: Size):
        self.frames, self.folder, self.size = frames, folder, size
        self._predicted = self._traced = None

    def render(self, renderer: Renderer, sampling: Mapping[str, int | None], show: Show) -> int:
        """Render what is not there yet; returns how many. A scene that only the camera moves through is encoded once.

        Args:
            sampling: of `Renderer.render`, by name.

        Raises:
            UserError: a frame cannot be made or written; those before it are kept.
        """
        chosen = f"{renderer.dtype} {self.size} {dict(sampling)}"
        origin = digest(weights_digest(renderer.engine.module), chosen.encode())
        self._predicted, made = FrameFolder(self.folder, origin), 0
        for shots in _of_one_scene(self._predicted.missing(self.frames)):
            show(shots[0].number, len(self.frames))
            images = renderer.views(_together(shots), self.size, **sampling)
            for shot, _ in zip(shots, written_beside(images, shots, self._predicted.write), strict=True):
                made += 1
                show(shot.number + 1, len(self.frames))
        return made

    def path_trace(self, settings: CyclesSettings, show: Show) -> int:
        """Path-trace what is not there yet; returns how many. Raises like `render`, and MissingDependencyError."""
        self._traced, made = FrameFolder(self.folder / "reference", digest(f"{settings} {self.size}".encode())), 0
        under_way: deque[Shot] = deque()

        def scenes() -> Iterator[PackedScene]:
            for shot in self._traced.missing(self.frames):
                show(shot.number, len(self.frames))
                under_way.append(shot)
                yield shot.scene

        for images, _ in path_traced(scenes(), self.size, settings):
            shot = under_way.popleft()
            self._traced.write(images[0], shot)
            made += 1
            show(shot.number + 1, len(self.frames))
        return made

    def pictures(self, tone_map: ToneMap) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """The rendered frames for display."""
        return map(tone_map, self._predicted.images(len(self.frames)))

    def comparison(self, tone_map: ToneMap) -> Iterator[UInt8[np.ndarray, "h wide 3"]]:
        """Reference, prediction and error (`rfpp.imaging.panels.error_map`) side by side."""
        count = len(self.frames)
        for image, reference in zip(self._predicted.images(count), self._traced.images(count), strict=True):
            parts = tone_map(reference), tone_map(image), error_map(image, reference)
            yield np.concatenate(parts, axis=1)

    def flicker(self) -> float:
        """See `rfpp.metrics.flicker`."""
        count = len(self.frames)
        return flicker(self._predicted.images(count), self._traced.images(count))


def _of_one_scene(shots: Iterable[Shot]) -> Iterator[list[Shot]]:
    """Neighbours that differ in nothing but the camera, together."""
    run: list[Shot] = []
    for shot in shots:
        if run and shot.scene.triangles is not run[0].scene.triangles:
            yield run
            run = []
        run.append(shot)
    if run:
        yield run


def _together(shots: Sequence[Shot]) -> PackedScene:
    """One scene with the cameras of all shots."""
    c2w, fov = (np.concatenate([getattr(shot.scene, name) for shot in shots]) for name in ("c2w", "fov"))
    return replace(shots[0].scene, c2w=c2w, fov=fov)

"""Animations: frames of a motion, rendered and path-traced into folders, and the pictures of their videos."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8

from rfpp.imaging.exr import ImageFileError, compact, decode_exr, exr_attributes, read_exr, write_exr
from rfpp.imaging.panels import error_map
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.bounded_cache import digest_of
from rfpp.inference.references import path_traced
from rfpp.inference.renderer import Renderer
from rfpp.inference.stills import written_in_background
from rfpp.metrics.flicker import flicker
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene

Image = Float[np.ndarray, "h w 3"]
#: Receives (finished frames, all frames); see `rfpp.progress.counting`.
Show = Callable[[int, int], None]
#: Name of the digest in a file's header.
_ORIGIN = "rendered_from"


class _Frame(NamedTuple):
    number: int
    scene: PackedScene
    origin: str  # digest of everything the image depends on


class _FrameFolder:
    """Frames in a folder: 00000.exr, 00001.exr, …, each with a digest of its scene, the renderer and its settings."""

    def __init__(self, folder: Path, settings: bytes):
        self._folder, self._settings = folder, settings

    def missing(self, frames: Sequence) -> Iterator[_Frame]:
        """Yield the frames whose files are missing, damaged, or have other inputs."""
        for number in range(len(frames)):
            scene = frames[number]
            triangles = scene.triangles
            arrays = triangles.positions, triangles.normals, triangles.material, triangles.object_offsets
            texture = () if scene.texture is None else (scene.texture,)
            origin = digest_of(self._settings, *arrays, scene.c2w, scene.fov, *texture).hex()
            if not self._holds(number, origin):
                yield _Frame(number, scene, origin)

    def write(self, image: Image, frame: _Frame) -> None:
        """Write a frame. Raises UserError if that fails."""
        write_exr(self._path(frame.number), {"RGB": compact(image)}, {_ORIGIN: frame.origin})

    def images(self, count: int) -> Iterator[Image]:
        """Yield the linear radiance of the first frames. Raises ImageFileError naming an unreadable one."""
        return (read_exr(self._path(number))["RGB"].astype(np.float32) for number in range(count))

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:05d}.exr"

    def _holds(self, number: int, origin: str) -> bool:
        try:
            data = self._path(number).read_bytes()
            return exr_attributes(data).get(_ORIGIN) == origin and "RGB" in decode_exr(data)
        except (OSError, ImageFileError):
            return False


class Animation:
    """Frames of an animation, rendered and optionally path-traced. Interrupted or changed animations are resumed.

    Args:
        frames: Frames of a motion, each a PackedScene with one camera, created on access.
        folder: Folder of the rendered frames; path-traced ones are in its subfolder `reference`.
        size: (height, width) in pixels.
    """

    def __init__(self, frames: Sequence, folder: Path, size: tuple[int, int]):
        self.frames, self.folder, self.size = frames, folder, size
        self._rendered = self._traced = None

    def render(self, renderer: Renderer, sampling: Mapping[str, int | None], show: Show) -> int:
        """Render missing frames, those of one scene together, and return their number.

        `sampling` holds arguments of `Renderer.render`, `show` receives the progress. Raises UserError if a frame
        cannot be created or written; earlier frames are kept.
        """
        weights = sorted(renderer.engine.module.state_dict().items())
        parts = (part for name, tensor in weights for part in (name.encode(), _array(tensor)))
        settings = f"{renderer.dtype} {self.size} {dict(sampling)}".encode()
        self._rendered, count = _FrameFolder(self.folder, digest_of(settings, *parts)), 0
        for _, group in groupby(self._rendered.missing(self.frames), lambda frame: id(frame.scene.triangles)):
            frames = list(group)
            show(frames[0].number, len(self.frames))
            c2w, fov = (np.concatenate([getattr(frame.scene, name) for frame in frames]) for name in ("c2w", "fov"))
            images = renderer.views(replace(frames[0].scene, c2w=c2w, fov=fov), self.size, **sampling)
            written = written_in_background(images, frames, self._rendered.write)
            for frame, _ in zip(frames, written, strict=True):
                count += 1
                show(frame.number + 1, len(self.frames))
        return count

    def path_trace(self, settings: CyclesSettings, show: Show) -> int:
        """Path-trace missing frames and return their number. Raises as `render`, and if Blender is missing."""
        self._traced, count = _FrameFolder(self.folder / "reference", digest_of(f"{settings} {self.size}".encode())), 0
        pending: deque[_Frame] = deque()

        def scenes() -> Iterator[PackedScene]:
            for frame in self._traced.missing(self.frames):
                show(frame.number, len(self.frames))
                pending.append(frame)
                yield frame.scene

        for images, _ in path_traced(scenes(), self.size, settings):
            frame = pending.popleft()
            self._traced.write(images[0], frame)
            count += 1
            show(frame.number + 1, len(self.frames))
        return count

    def pictures(self, tone_map: ToneMap) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """Yield the rendered frames for display."""
        return map(tone_map, self._rendered.images(len(self.frames)))

    def comparison(self, tone_map: ToneMap) -> Iterator[UInt8[np.ndarray, "h wide 3"]]:
        """Yield reference, prediction and error (`rfpp.imaging.panels.error_map`) side by side."""
        count = len(self.frames)
        for image, reference in zip(self._rendered.images(count), self._traced.images(count), strict=True):
            yield np.concatenate([tone_map(reference), tone_map(image), error_map(image, reference)], axis=1)

    def flicker(self) -> float:
        """Return the flicker, see `rfpp.metrics.flicker`."""
        count = len(self.frames)
        return flicker(self._rendered.images(count), self._traced.images(count))


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()

"""Layers of the viewer: the image, the light after each transport, and the G-buffers."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float, UInt8

from rfpp.imaging.panels import false_colors
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.light_mixing import LightMixer
from rfpp.inference.renderer import Renderer
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS
from rfpp.scene.packed import PackedScene

Picture = UInt8[np.ndarray, "h w 3"]
Size = tuple[int, int]
#: Sampling of drafts: faster, with more noise and rougher outlines.
_DRAFT = {"light_samples": 1, "supersampling": 1}


class Layer(ABC):
    """A kind of picture."""

    #: Whether drafts are faster than pictures.
    has_drafts = False

    @abstractmethod
    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap, is_draft: bool = False) -> Picture:
        """Return the picture of a scene with one camera in (height, width) pixels."""

    def is_instant(self, scene: PackedScene, size: Size) -> bool:
        """Return whether `picture` needs no rendering."""
        return False


class Image(Layer):
    """The rendered image after some transport iterations, or the usual number."""

    def __init__(self, renderer: Renderer, transports: int | None = None):
        self._renderer, self._transports = renderer, transports
        self.has_drafts = renderer.engine.supersamples

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap, is_draft: bool = False) -> Picture:
        sampling = _DRAFT if is_draft and self.has_drafts else {}
        return tone_map(next(self._renderer.views(scene, size, transports=self._transports, **sampling)))


class MixedLights(Layer):
    """The rendered image of a model that is linear in lights, which change without rendering again."""

    has_drafts = True

    def __init__(self, renderer: Renderer):
        self._mixer = LightMixer(renderer)

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap, is_draft: bool = False) -> Picture:
        return tone_map(self._mixer.image(scene, size, **(_DRAFT if is_draft else {})))

    def is_instant(self, scene: PackedScene, size: Size) -> bool:
        return self._mixer.is_separated(scene, size)


class Channel(Layer):
    """A channel of the G-buffer."""

    def __init__(self, name: str):
        self._name, self._source = name, GBufferSource([name])

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap, is_draft: bool = False) -> Picture:
        return _colored(np.moveaxis(self._source.of(scene, *size, 16)(0), 0, -1), self._name, tone_map)


def _colored(pixels: Float[np.ndarray, "h w c"], name: str, tone_map: ToneMap) -> Picture:
    """Return vectors as colors and numbers in false colors, depth relative to the farthest point."""
    if name in COLOR_CHANNELS:
        return tone_map(pixels)
    if CHANNELS[name] == 1:
        return false_colors(pixels[..., 0] / max(pixels.max(), 1e-9) if name == "depth" else pixels[..., 0])
    hit = (pixels != 0).any(axis=-1, keepdims=True)
    return np.where(hit, np.clip(127.5 * (pixels + 1), 0, 255), 0).astype(np.uint8)


def layers_of(renderer: Renderer) -> dict[str, Layer]:
    """Return the layers by their names in the viewer."""
    transports = range(renderer.engine.iterations + 1) if renderer.engine.iterations else ()
    return (
        {"image": MixedLights(renderer) if renderer.engine.is_linear else Image(renderer)}
        | {f"light after {k} transports": Image(renderer, k) for k in transports}
        | {name.replace("_", " "): Channel(name) for name in CHANNELS}
    )

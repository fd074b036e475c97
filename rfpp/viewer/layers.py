"""Layers of the viewer: the image, the light after each transport, and the G-buffers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from rfpp.imaging.panels import false_colours
from rfpp.imaging.tone_maps import ToneMap
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.light_mixing import LightMixer
from rfpp.inference.renderer import Renderer
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS
from rfpp.scene.packed import PackedScene

Picture = UInt8[np.ndarray, "h w 3"]
Size = tuple[int, int]
#: Sampling of frames in motion: faster, with more noise and rougher outlines.
_DRAFT = {"light_samples": 1, "supersampling": 1}


class Layer(ABC):
    """A kind of picture, of a scene with one camera."""

    @abstractmethod
    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap) -> Picture:
        """(height, width) pixels."""

    def at_once(self, scene: PackedScene, size: Size) -> bool:
        """Whether `picture` has nothing to compute but sums."""
        return False

    @property
    def in_motion(self) -> Layer:
        """The same in a faster way, for pictures that are over at once; itself where there is none."""
        return self


@dataclass(frozen=True)
class Rendered(Layer):
    """The rendered image.

    Attributes:
        renderer: Renderer of the image.
        transports: Transport iterations; None for the usual number.
        is_draft: Whether to use fewer samples.
    """

    renderer: Renderer
    transports: int | None = None
    is_draft: bool = False

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap) -> Picture:
        [radiance] = self.renderer.views(scene, size, transports=self.transports, **(_DRAFT if self.is_draft else {}))
        return tone_map(radiance)

    @property
    def in_motion(self) -> Rendered:
        return replace(self, is_draft=self.renderer.engine.supersamples)


@dataclass(frozen=True)
class Mixed(Layer):
    """The rendered image of a model that is linear in lights, which are dimmed and colored without rendering again.

    Attributes:
        mixer: Renderer of single lights.
        is_draft: See `Rendered`.
    """

    mixer: LightMixer
    is_draft: bool = False

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap) -> Picture:
        return tone_map(self.mixer.image(scene, size, **(_DRAFT if self.is_draft else {})))

    @property
    def in_motion(self) -> Mixed:
        return replace(self, is_draft=True)

    def at_once(self, scene: PackedScene, size: Size) -> bool:
        return self.mixer.ready(scene, size)


@dataclass(frozen=True)
class Channel(Layer):
    """A G-buffer."""

    name: str
    source: GBufferSource
    light_samples: int = 16

    def picture(self, scene: PackedScene, size: Size, tone_map: ToneMap) -> Picture:
        return channel_picture(self.source.of(scene, *size, self.light_samples)(0), self.name, tone_map)


def channel_picture(values: Float[np.ndarray, "c h w"], name: str, tone_map: ToneMap) -> Picture:
    """Return vectors as colors and numbers in false colors; depth relative to the farthest point."""
    pixels = np.moveaxis(values, 0, -1)
    if name in COLOR_CHANNELS:
        return tone_map(pixels)
    if CHANNELS[name] == 1:
        return false_colours(pixels[..., 0] / max(pixels.max(), 1e-9) if name == "depth" else pixels[..., 0])
    hit = (pixels != 0).any(axis=-1, keepdims=True)
    return np.where(hit, np.clip(127.5 * (pixels + 1), 0, 255), 0).astype(np.uint8)


def layers_of(renderer: Renderer) -> dict[str, Layer]:
    """Return the layers by their names in the viewer."""
    transports = renderer.engine.iterations
    image = Mixed(LightMixer(renderer)) if renderer.engine.is_linear else Rendered(renderer)
    return (
        {"image": image}
        | {f"light after {k} transports": Rendered(renderer, k) for k in range(transports + 1) if transports}
        | {name.replace("_", " "): Channel(name, GBufferSource([name])) for name in CHANNELS}
    )

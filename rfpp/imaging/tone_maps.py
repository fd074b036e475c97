"""Tone maps: linear radiance → an 8-bit picture. Variants are classes, named in conf/render/tone_map/*.yaml.

Nothing is measured in the image: the exposure is what the caller says, so that a video does not pump, pictures of one
scene can be compared, and a reference is shown as its prediction is. Radiance 1 is what a white surface sends back when
light of irradiance π falls on it: the project's scenes are lit to stay around and below that, highlights apart.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from rfpp.imaging.radiance import exposed, perceptual, srgb, to_8bit

#: Far beyond white in every tone map, and still a number.
_BRIGHTEST = 1e9


class ToneMap(ABC):
    """Linear radiance → 8 bits for an sRGB display. NaN is black, as in `rfpp.imaging.radiance.to_8bit`, ∞ white.

    Args:
        stops: exposure; one more doubles the radiance before anything else.
    """

    def __init__(self, stops: float | int = 0.0):
        self.stops = float(stops)

    def __call__(self, radiance: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        linear = torch.from_numpy(np.ascontiguousarray(radiance, dtype=np.float32))
        return to_8bit(self.display(exposed(linear, self.stops).clamp(0, _BRIGHTEST))).numpy()

    @abstractmethod
    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """Display values in [0, 1], already in the sRGB encoding, of radiance that was exposed."""


class SRGB(ToneMap):
    """The sRGB curve and nothing else: radiance up to 1 is shown as it is, anything brighter is clipped."""

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        return srgb(radiance)


class Perceptual(ToneMap):
    """clamp(log2(1 + I), 0, 1), shown as it is: what the losses and metrics called perceptual look at."""

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        return perceptual(radiance)


class Neutral(ToneMap):
    """Khronos PBR Neutral: base colours stay as they are, only highlights are compressed and paled.

    The formula of its specification (Khronos Group, PBR Neutral Tone Mapper 1.0, 2024,
    https://github.com/KhronosGroup/ToneMapping/tree/main/PBR_Neutral). A glossy dielectric reflects 4% at normal
    incidence, which is subtracted; what is then at most 0.76 is shown as it is, under the sRGB curve.
    """

    _F90 = 0.04
    _START = 0.8 - _F90  # of compression
    _DESATURATION = 0.15

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        least = radiance.amin(dim=-1, keepdim=True)
        offset = torch.where(least <= 2 * self._F90, least - least.square() / (4 * self._F90), self._F90)
        colour = radiance - offset
        peak = colour.amax(dim=-1, keepdim=True)
        headroom = 1 - self._START
        compressed = 1 - headroom**2 / (peak.clamp_min(self._START) + headroom - self._START)
        white = 1 - 1 / (self._DESATURATION * (peak - compressed) + 1)
        highlight = torch.lerp(colour * (compressed / peak.clamp_min(self._START)), compressed, white)
        return srgb(torch.where(peak <= self._START, colour, highlight))


class AgX(ToneMap):
    """AgX by Troy Sobotka, without a look: 16.5 stops on a film-like curve, bright colours pale towards white.

    From its definition (https://github.com/sobotka/AgX): Rec. 709's primaries are drawn towards white by a fifth; the
    logarithm of each channel, from 10 stops below middle grey to 6.5 above, goes through a sigmoid that sends middle
    grey, 0.18, to half of the display's signal. Colours are then drawn out again by as much, as in most versions since
    (https://iolite-engine.com/blog_posts/minimal_agx_implementation).
    """

    _GREY, _STOPS_BELOW, _STOPS_ABOVE = 0.18, 10.0, 6.5
    _INSET = 0.2
    _SLOPE, _TOE, _SHOULDER = 2.0, 3.0, 3.25  # of the sigmoid at middle grey, and how sharply it bends
    _DISPLAY_GAMMA = 2.2

    def __init__(self, stops: float | int = 0.0):
        super().__init__(stops)
        inset = torch.from_numpy(_drawn_to_white(self._INSET))
        self._inset, self._outset = inset.T.float(), inset.inverse().T.float()

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        scene = (radiance @ self._inset).clamp_min(1e-10)
        position = (torch.log2(scene / self._GREY) + self._STOPS_BELOW) / (self._STOPS_BELOW + self._STOPS_ABOVE)
        signal = self._sigmoid(position.clamp(0, 1)) @ self._outset
        return srgb(signal.clamp(0, 1) ** self._DISPLAY_GAMMA)

    def _sigmoid(self, position: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """1/2 + s d (1 + a |d|ᵖ)^(-1/p) with d the distance from middle grey; a is such that 0 → 0 and 1 → 1."""
        grey = self._STOPS_BELOW / (self._STOPS_BELOW + self._STOPS_ABOVE)
        distance = position - grey
        halves = ((self._TOE, grey), (self._SHOULDER, 1 - grey))
        toe, shoulder = (
            0.5
            + self._SLOPE
            * distance
            * (1 + ((2 * self._SLOPE * reach) ** power - 1) * (distance.abs() / reach) ** power) ** (-1 / power)
            for power, reach in halves
        )
        return torch.where(distance < 0, toe, shoulder)


def _drawn_to_white(share: float) -> Float[np.ndarray, "3 3"]:
    """Linear Rec. 709 → the same light in primaries whose distances from white are smaller by a share, [out, in]."""
    primaries, white = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]]), np.array([0.3127, 0.3290])
    return np.asarray(
        np.linalg.inv(_to_xyz(primaries, white)) @ _to_xyz(white + (primaries - white) * (1 - share), white)
    )


def _to_xyz(primaries: Float[np.ndarray, "3 2"], white: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "3 3"]:
    """RGB → XYZ of primaries and a white point given as (x, y); RGB (1, 1, 1) is white with Y = 1."""
    x, y, z = np.stack([*np.vstack([primaries, white]).T, 1 - np.vstack([primaries, white]).sum(axis=1)])
    directions = np.stack([x, y, z]) / y
    return np.asarray(directions[:, :3] * np.linalg.solve(directions[:, :3], directions[:, 3]))

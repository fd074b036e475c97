"""Tone maps: linear radiance → an 8-bit picture. Variants are classes.

The exposure is an argument and never measured in the image, so that animations do not flicker and pictures of one
scene are comparable. A white surface under irradiance π has radiance 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from rfpp.errors import UserError
from rfpp.imaging.radiance import exposed, perceptual, srgb, to_8bit

#: White in every tone map, and finite.
_BRIGHTEST = 1e9


class ToneMap(ABC):
    """Linear radiance → 8 bits for an sRGB display; NaN becomes black, infinity white.

    Args:
        stops: Exposure; each stop doubles the radiance.
    """

    def __init__(self, stops: float | int = 0.0):
        self.stops = float(stops)

    def __call__(self, radiance: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """Return the picture."""
        linear = torch.from_numpy(np.ascontiguousarray(radiance, dtype=np.float32))
        return to_8bit(self.display(exposed(linear, self.stops).clamp(0, _BRIGHTEST))).numpy()

    @abstractmethod
    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """Return sRGB-encoded display values in [0, 1] of exposed radiance."""


class SRGB(ToneMap):
    """The sRGB curve; radiance above 1 is clipped."""

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        return srgb(radiance)


class Perceptual(ToneMap):
    """clamp(log2(1 + I), 0, 1) without a display curve: the tone map of perceptual losses and metrics."""

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        return perceptual(radiance)


class Neutral(ToneMap):
    """Khronos PBR Neutral 1.0: base colors stay as they are, and only highlights are compressed and desaturated.

    The reflection of a dielectric at normal incidence, 4%, is subtracted; what is then at most 0.76 has the sRGB curve
    alone (https://github.com/KhronosGroup/ToneMapping/tree/main/PBR_Neutral).
    """

    _F90, _START, _DESATURATION = 0.04, 0.76, 0.15

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        least = radiance.amin(dim=-1, keepdim=True)
        color = radiance - torch.where(least <= 2 * self._F90, least - least.square() / (4 * self._F90), self._F90)
        peak, headroom = color.amax(dim=-1, keepdim=True), 1 - self._START
        compressed = 1 - headroom**2 / (peak.clamp_min(self._START) + headroom - self._START)
        white = 1 - 1 / (self._DESATURATION * (peak - compressed) + 1)
        highlight = torch.lerp(color * (compressed / peak.clamp_min(self._START)), compressed, white)
        return srgb(torch.where(peak <= self._START, color, highlight))


class AgX(ToneMap):
    """AgX by Troy Sobotka (https://github.com/sobotka/AgX), without a look: 16.5 stops on a film-like curve.

    The logarithm of each channel, from 10 stops below middle gray to 6.5 above, goes through a sigmoid that maps
    middle gray, 0.18, to half the signal. Bright colors fade to white, because the primaries are moved toward white
    before and back afterwards (https://iolite-engine.com/blog_posts/minimal_agx_implementation).
    """

    _GRAY, _STOPS_BELOW, _STOPS_ABOVE = 0.18, 10.0, 6.5
    _SLOPE, _TOE, _SHOULDER = 2.0, 3.0, 3.25  # of the sigmoid: slope at middle gray, and exponents below and above
    _DISPLAY_GAMMA = 2.2
    #: Linear Rec. 709 → primaries that are a fifth closer to white, [out, in].
    _INSET = torch.tensor([
        [0.842398929, 0.0784301651, 0.0791709058],
        [0.042398929, 0.8784301651, 0.0791709058],
        [0.042398929, 0.0784301651, 0.8791709058],
    ])  # fmt: skip
    _OUTSET = _INSET.inverse()

    def display(self, radiance: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        scene = (radiance @ self._INSET.T).clamp_min(1e-10)
        position = (torch.log2(scene / self._GRAY) + self._STOPS_BELOW) / (self._STOPS_BELOW + self._STOPS_ABOVE)
        signal = self._sigmoid(position.clamp(0, 1)) @ self._OUTSET.T
        return srgb(signal.clamp(0, 1) ** self._DISPLAY_GAMMA)

    def _sigmoid(self, position: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """Return 1/2 + s d (1 + a |d|ᵖ)^(-1/p), d the distance from middle gray; a maps 0 to 0 and 1 to 1."""
        gray = self._STOPS_BELOW / (self._STOPS_BELOW + self._STOPS_ABOVE)
        distance = position - gray

        def half(power: float, reach: float) -> Float[Tensor, "h w 3"]:
            bend: Tensor = ((2 * self._SLOPE * reach) ** power - 1) * (distance.abs() / reach).pow(power)
            return 0.5 + self._SLOPE * distance * (1 + bend).pow(-1 / power)

        return torch.where(distance < 0, half(self._TOE, gray), half(self._SHOULDER, 1 - gray))


#: Tone maps by name on the command line; the first is the default.
TONE_MAPS: dict[str, type[ToneMap]] = {"srgb": SRGB, "perceptual": Perceptual, "neutral": Neutral, "agx": AgX}


def tone_map_of(name: str, stops: float | int) -> ToneMap:
    """Return the tone map with this name. Raises UserError listing the available names."""
    if name not in TONE_MAPS:
        raise UserError(f"tone_map={name} does not exist: choose from {', '.join(TONE_MAPS)}")
    return TONE_MAPS[name](stops)

"""From the image head's maps to radiance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_decode, log_encode


@runtime_checkable
class Shading(Protocol):
    """What a decoder's maps mean. Besides them, each decoder hands its own kind of shading what else that reads."""

    @property
    def maps(self) -> int:
        """How many the head gives."""

    @property
    def channels(self) -> tuple[str, ...]:
        """What is needed of the G-buffer, in order."""

    def __call__(self, maps: Tensor, *others: Any) -> Tensor: ...


class LogRadiance:
    """The head's maps are log10(1 + radiance) (paper, Sec. 3.3, after RenderFormer)."""

    #: Maps the head gives.
    maps = 3
    #: What it needs of the G-buffer.
    channels: tuple[str, ...] = ()

    def __call__(self, maps: Float[Tensor, "n 3 h w"], gbuffer: Float[Tensor, "n 0 h w"]) -> Float[Tensor, "n 3 h w"]:
        return log_decode(_elu(maps))


class ReflectedLight:
    """The head's maps are log10(1 + light), once as the surface's diffuse and once as its glossy lobe gathers it.

    Not in the paper. The light that leaves a first hit is albedo · (diffuse light) + specular · (glossy light), and
    both reflectances are in the G-buffer, sharp to the pixel: what remains to be predicted is the light. (Path
    tracers' denoisers divide albedo out for the same reason.) Emitters cannot be seen, so there is no third term.
    """

    maps = 6
    channels: tuple[str, ...] = ("albedo", "specular")

    def __call__(self, maps: Float[Tensor, "n 6 h w"], gbuffer: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 3 h w"]:
        diffuse, glossy = log_decode(_elu(maps)).chunk(2, dim=1)
        albedo, specular = gbuffer.chunk(2, dim=1)
        return albedo * diffuse + specular * glossy


class LightBeyondDirect(ReflectedLight):
    """As ReflectedLight, but the direct light is known, and the head's maps say what is to be added to it.

    Not in the paper. T L_e, the first bounce of the rendering equation's series, is computed with its shadows
    (`rfpp.gbuffer.known_light`) and arrives as log10(1 + light) in the G-buffer. Six maps are log10(1 + light) of
    every further bounce, which is smooth where the first has a shadow's edge. The other six let the known light be
    corrected, by a factor 2 σ(map): it carries the noise of its samples, and highlights that pixels are too coarse for.
    Maps of zero give the direct light alone.
    """

    maps = 12
    channels: tuple[str, ...] = (*ReflectedLight.channels, "direct_diffuse", "direct_glossy")

    def __call__(self, maps: Float[Tensor, "n 12 h w"], gbuffer: Float[Tensor, "n 12 h w"]) -> Float[Tensor, "n 3 h w"]:
        correction, further = maps.chunk(2, dim=1)
        reflectance, direct = gbuffer.chunk(2, dim=1)
        diffuse, glossy = (2 * correction.sigmoid() * log_decode(direct)).chunk(2, dim=1)
        albedo, specular = reflectance.chunk(2, dim=1)
        return albedo * diffuse + specular * glossy + super().__call__(further, reflectance)


class LightBeyondReflection(LightBeyondDirect):
    """As LightBeyondDirect, to whose glossy light the reflection of directly lit surfaces is added.

    Not in the paper. A mirror shows what first hits know nothing of (`rfpp.gbuffer.known_light`), sharp to the pixel.
    """

    channels: tuple[str, ...] = (*LightBeyondDirect.channels, "reflected_light")

    def __call__(self, maps: Float[Tensor, "n 12 h w"], gbuffer: Float[Tensor, "n 15 h w"]) -> Float[Tensor, "n 3 h w"]:
        known, glossy, reflected = gbuffer.split([9, 3, 3], dim=1)
        glossy = log_encode(log_decode(glossy) + log_decode(reflected))
        return super().__call__(maps, torch.cat([known, glossy], dim=1))


class _ELU(torch.autograd.Function):
    """ELU(α = 10⁻³), RenderFormer's output, whose gradient does not die below zero.

    There the true slope is α at most, so a pixel that has turned black would hardly come back. A gradient that asks
    for more light is therefore passed on undamped.
    """

    ALPHA = 1e-3

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return F.elu(x, alpha=_ELU.ALPHA)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> Tensor:
        (x,) = ctx.saved_tensors
        slope = torch.where((x > 0) | (grad < 0), 1.0, _ELU.ALPHA * x.clamp(max=0).exp())
        return grad * slope


_elu: Callable[..., Tensor] = _ELU.apply  # torch's has no types

"""From the image head's maps to radiance."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from rfpp.radiance import log_decode


class LogRadiance:
    """The head's maps are log10(1 + radiance) (paper, Sec. 3.3, after RenderFormer)."""

    #: Maps the head gives.
    maps = 3
    #: What it needs of the G-buffer.
    channels: tuple[str, ...] = ()

    def __call__(self, maps: Float[Tensor, "n 3 h w"], gbuffer: Float[Tensor, "n 0 h w"]) -> Float[Tensor, "n 3 h w"]:
        return log_decode(maps)


class ReflectedLight:
    """The head's maps are log10(1 + light), once as the surface's diffuse and once as its glossy lobe gathers it.

    Not in the paper. The light that leaves a first hit is albedo · (diffuse light) + specular · (glossy light), and
    both reflectances are in the G-buffer, sharp to the pixel: what remains to be predicted is the light. (Path
    tracers' denoisers divide albedo out for the same reason.) Emitters cannot be seen, so there is no third term.
    """

    maps = 6
    channels: tuple[str, ...] = ("albedo", "specular")

    def __call__(self, maps: Float[Tensor, "n 6 h w"], gbuffer: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 3 h w"]:
        diffuse, glossy = log_decode(maps).chunk(2, dim=1)
        albedo, specular = gbuffer.chunk(2, dim=1)
        return albedo * diffuse + specular * glossy

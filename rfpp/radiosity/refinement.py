"""Refinement: a convolutional network that corrects the finished image, guided by the G-buffer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.imaging.radiance import log_encode

#: Logit of a pixel's own place in the kernel before training: it keeps 7/8 of itself.
_OWN = 4.0
#: Limit of neighbors: the pixel's own radiance times the first, plus the image's mean times the second.
_BRIGHTER = 2.0, 4.0


class Refinement(nn.Module):
    """U-Net (Ronneberger et al. 2015) that reads image and G-buffer and predicts two corrections of the image.

    Each pixel becomes a weighted mean of itself and its eight neighbors (kernel prediction, Bako et al. 2017), times
    factors exp(γ tanh(map)) of red, green and blue. The image keeps its mean radiance, which logarithms in the loss
    would lower where it is noisy. A black pixel without a surface stays black, so that no light spills over an
    outline. The image is read in units of its mean: twice the light gives exactly twice the image. The refined image is
    not linear in single lights.

    Args:
        widths: Channels at full, half and quarter resolution.
        bound: γ, which bounds each correction.
    """

    #: G-buffer channels, in order.
    channels: tuple[str, ...] = ("albedo", "specular", "roughness", "normal", "position")

    def __init__(self, widths: Sequence[int], bound: float):
        super().__init__()
        fine, half, quarter = widths
        self.bound = bound
        self.at_full = nn.Sequential(_conv(_INPUTS, fine), nn.SiLU(), _conv(fine, fine), nn.SiLU())
        self.at_half = nn.Sequential(_conv(fine, half), nn.SiLU(), _conv(half, half), nn.SiLU())
        self.at_quarter = nn.Sequential(_conv(half, quarter), nn.SiLU(), _conv(quarter, quarter), nn.SiLU())
        self.to_half = nn.Sequential(_conv(quarter + half, half), nn.SiLU())
        self.to_full = nn.Sequential(_conv(half + fine, fine), nn.SiLU())
        self.out = nn.Conv2d(fine, 3 + 9, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(cast(Tensor, self.out.bias))

    def forward(
        self, radiance: Float[Tensor, "n 3 h w"], gbuffer: Float[Tensor, "n 13 h w"], fov: Float[Tensor, " n"]
    ) -> Float[Tensor, "n 3 h w"]:
        """Return the corrected linear radiance.

        Args:
            radiance: Linear radiance; negative values count as zero.
            fov: Full angle in degrees along the longer image side.
        """
        radiance = radiance.float().clamp_min(0)
        seen = torch.cat([_light(radiance), _surfaces(gbuffer, fov)], dim=1).contiguous(
            memory_format=torch.channels_last
        )
        fine = self.at_full(seen)
        half = self.at_half(F.avg_pool2d(fine, 2, ceil_mode=True))
        quarter = self.at_quarter(F.avg_pool2d(half, 2, ceil_mode=True))
        half = self.to_half(torch.cat([_enlarged(quarter, half), half], dim=1))
        fine = self.to_full(torch.cat([_enlarged(half, fine), fine], dim=1))
        factors, weights = self.out(fine).float().split([3, 9], dim=1)
        lit_or_surface = radiance.amax(1, keepdim=True) + _hit(gbuffer) > 0
        with torch.autocast(radiance.device.type, enabled=False):
            refined = lit_or_surface * torch.exp(self.bound * torch.tanh(factors)) * _mixed(radiance, weights)
            return refined * _energy(radiance, radiance) / _energy(refined, radiance).clamp_min(1e-20)


#: Image 3, albedo 3, specular 3, roughness, normal 3, size of a pixel, whether there is a surface.
_INPUTS = 15


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)


def _light(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Encode the image logarithmically, in units of its mean."""
    mean = radiance.mean((1, 2, 3), keepdim=True)
    return 2 * log_encode(radiance / mean.clamp_min(1e-20))


def _surfaces(gbuffer: Float[Tensor, "n 13 h w"], fov: Float[Tensor, " n"]) -> Float[Tensor, "n 12 h w"]:
    """Encode the G-buffer; of positions only the size of a pixel there, in octaves.

    The reach of contact shadows is a length, not a number of pixels.
    """
    material, normal, position = gbuffer.split([7, 3, 3], dim=1)
    hit = _hit(gbuffer)
    pixel = 2 * torch.tan(torch.deg2rad(fov) / 2)[:, None, None, None] / max(gbuffer.shape[-2:])
    size = pixel * position.square().sum(1, keepdim=True).sqrt()
    return torch.cat([material, normal, hit * torch.log2(64 * size.clamp_min(1e-6)), hit], dim=1)


def _hit(gbuffer: Float[Tensor, "n 13 h w"]) -> Float[Tensor, "n 1 h w"]:
    """Return 1 where any sample of a pixel hits a surface, else 0."""
    normal = gbuffer[:, 7:10]
    return (normal.square().sum(1, keepdim=True) > 0).to(gbuffer)


def _enlarged(
    x: Float[Tensor, "n c h w"], like: Float[Tensor, "n _ height width"]
) -> Float[Tensor, "n c height width"]:
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)


def _energy(image: Float[Tensor, "n 3 h w"], unrefined: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 1 1 1"]:
    """Return the mean radiance, in which a highlight counts up to a limit."""
    limit = _BRIGHTER[1] * unrefined.mean((1, 2, 3), keepdim=True)
    return torch.minimum(image, limit).mean((1, 2, 3), keepdim=True)


def _mixed(image: Float[Tensor, "n 3 h w"], weights: Float[Tensor, "n 9 h w"]) -> Float[Tensor, "n 3 h w"]:
    """Average each pixel with its neighbors, by the softmax of its weights.

    Neighbors are dimmed to a limit (`_BRIGHTER`): beside a surface that a light touches, a small share of it would
    be most of the pixel.
    """
    own = _OWN * (torch.arange(9, device=weights.device) == 4)
    shares = torch.softmax(weights + own[:, None, None], dim=1)
    padded, (height, width) = F.pad(image, [1] * 4, mode="replicate"), image.shape[-2:]
    times, means = _BRIGHTER
    limit = times * image.amax(1, keepdim=True) + means * image.mean((1, 2, 3), keepdim=True)
    mixed = torch.zeros_like(image)
    for place in range(9):
        row, column = divmod(place, 3)
        neighbor = padded[..., row : row + height, column : column + width]
        dimmed = neighbor * (limit / neighbor.amax(1, keepdim=True).clamp_min(1e-20)).clamp_max(1)
        mixed = mixed + shares[:, place, None] * dimmed
    return mixed

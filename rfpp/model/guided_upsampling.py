"""Maps of coarse pixels carried to fine ones, along surfaces and not across their outlines."""

from __future__ import annotations

from itertools import product

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.gbuffer.first_hit import CHANNELS


class GuidedUpsampling:
    """Joint bilateral upsampling (Kopf et al. 2007): each pixel takes the mean of the four coarse pixels around it.

    They count as far as they are near, face the same way and lie in the same plane as the pixel; where none does, as
    far as they are near.

    Args:
        normal: difference of unit normals at which a weight has fallen to e^-1/2.
        plane: distance from the pixel's tangent plane, in world units, likewise.
    """

    channels: tuple[str, ...] = ("normal", "position")
    #: Numbers of these channels.
    size = sum(CHANNELS[name] for name in channels)
    #: Weight of a coarse pixel of another surface: without one there is nothing to divide by.
    _OTHER = 1e-4

    def __init__(self, normal: float = 0.3, plane: float = 0.02):
        self.normal, self.plane = normal, plane

    def __call__(
        self,
        maps: Float[Tensor, "n maps h w"],
        coarse: Float[Tensor, "n 6 h w"],
        fine: Float[Tensor, "n 6 height width"],
    ) -> Float[Tensor, "n maps height width"]:
        """Maps of fine pixels.

        Args:
            coarse, fine: `channels` of both kinds of pixels; a coarse one is a square of whole fine ones.
        """
        stride, (height, width) = fine.shape[-1] // coarse.shape[-1], fine.shape[-2:]
        maps, guides = (_spread(x.contiguous(), stride) for x in (maps, coarse))  # heads give channels last
        near = [_nearness(size, stride, fine.device) for size in (height, width)]
        places, weights = [], []
        for row, column in product(range(2), range(2)):
            here = (..., slice(row * stride, row * stride + height), slice(column * stride, column * stride + width))
            weight = near[0][row][:, None] * near[1][column] * (self._alike(fine, guides[here]) + self._OTHER)
            places.append(here)
            weights.append(weight)
        whole, carried = torch.stack(weights).sum(0), maps.new_zeros(*maps.shape[:2], height, width)
        for here, weight in zip(places, weights, strict=True):
            carried.addcmul_(weight / whole, maps[here])
        return carried

    @torch.no_grad()
    def _alike(self, here: Float[Tensor, "n 6 h w"], there: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 1 h w"]:
        (normal, position), (its_normal, its_position) = (x.split(3, dim=1) for x in (here, there))
        off_plane = ((its_position - position) * normal).sum(1, keepdim=True) / self.plane
        turned = (its_normal - normal).square().sum(1, keepdim=True) / self.normal**2
        return torch.exp(-0.5 * (off_plane.square() + turned))


def _spread(coarse: Float[Tensor, "n c h w"], stride: int) -> Float[Tensor, "n c _ _"]:
    """Of each fine pixel the coarse one before it; so many pixels further on, the one after it."""
    spread = F.interpolate(F.pad(coarse, [1] * 4, mode="replicate"), scale_factor=stride, mode="nearest")
    first = (stride + 1) // 2
    return spread[..., first:, first:]


def _nearness(size: int, stride: int, device: torch.device) -> tuple[Float[Tensor, " size"], Float[Tensor, " size"]]:
    """Along an axis, of the coarse pixels before and after each fine one's centre: 1 together."""
    place = (torch.arange(size, device=device) + 0.5) / stride - 0.5
    after = place - place.floor()
    return 1 - after, after

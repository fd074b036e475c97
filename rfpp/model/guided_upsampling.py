"""Maps of coarse pixels carried to fine ones, along surfaces and not across their outlines."""

from __future__ import annotations

from itertools import product

import torch
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
            coarse, fine: `channels` of both kinds of pixels.
        """
        rows, columns = (_neighbours(*sides, maps.device) for sides in zip(maps.shape[2:], fine.shape[2:], strict=True))
        total, weights = maps.new_zeros(*maps.shape[:2], *fine.shape[2:]), fine.new_zeros(len(fine), 1, *fine.shape[2:])
        for (row, near_row), (column, near_column) in product(rows, columns):
            there = coarse.index_select(2, row).index_select(3, column)
            weight = near_row[:, None] * near_column * (self._alike(fine, there) + self._OTHER)
            total += weight * maps.index_select(2, row).index_select(3, column)
            weights += weight
        return total / weights

    @torch.no_grad()
    def _alike(self, here: Float[Tensor, "n 6 h w"], there: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 1 h w"]:
        (normal, position), (its_normal, its_position) = (x.split(3, dim=1) for x in (here, there))
        off_plane = ((its_position - position) * normal).sum(1, keepdim=True) / self.plane
        turned = (its_normal - normal).square().sum(1, keepdim=True) / self.normal**2
        return torch.exp(-0.5 * (off_plane.square() + turned))


def _neighbours(
    coarse: int, fine: int, device: torch.device
) -> tuple[tuple[Tensor, Float[Tensor, " fine"]], tuple[Tensor, Float[Tensor, " fine"]]]:
    """The coarse pixels before and after each fine one's centre along an axis, and how near each is: 1 together."""
    place = (torch.arange(fine, device=device) + 0.5) * (coarse / fine) - 0.5
    before = place.floor()
    near = place - before
    first, second = (row.clamp(0, coarse - 1).long() for row in (before, before + 1))
    return (first, 1 - near), (second, near)

"""Light shared among neighbouring pixels of one surface: what single rays bring each of them is noise."""

from __future__ import annotations

from itertools import product

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.gbuffer.first_hit import CHANNELS


class JointWindow:
    """A weighted mean over a square window, with weights of the G-buffer alone: linear in light.

    As in a joint bilateral filter, neighbours count that face the same way and lie in one plane; for glossy light, the
    nearer the shinier a surface is, so that mirrors stay sharp.

    Finer images are filtered again with every second pixel of a window twice as large, every fourth, and so on, so that
    the same share of the image is shared at any resolution ("à trous", Dammertz et al. 2010).

    Args:
        radius: pixels to each side.
        reach: share of the image's longer side that all windows together may span to each side; one there always is, a
            second from 120 pixels on.
        normal: difference of unit normals at which a weight has fallen to e^-1/2.
        plane: distance from the neighbour's tangent plane, in world units, likewise.
        spread: distance in pixels, likewise, for diffuse light; for glossy light, at roughness 1.
    """

    channels: tuple[str, ...] = ("normal", "position", "roughness")
    #: Numbers of these channels.
    size = sum(CHANNELS[name] for name in channels)
    #: Distance in pixels at which a mirror's weight has fallen to e^-1/2.
    SHARPEST = 0.3

    def __init__(
        self, radius: int = 2, reach: float = 0.05, normal: float = 0.3, plane: float = 0.01, spread: float = 2.0
    ):
        self.radius, self.reach = radius, reach
        self.normal, self.plane, self.spread = normal, plane, spread

    def __call__(self, light: Float[Tensor, "n 6 h w"], guides: Float[Tensor, "n 7 h w"]) -> Float[Tensor, "n 6 h w"]:
        """Diffuse and glossy light, each filtered."""
        step, spanned = 1, self.radius
        light = self._filtered(light, guides, step)
        while (spanned := spanned + 2 * step * self.radius) <= self.reach * max(light.shape[-2:]):
            step *= 2
            light = self._filtered(light, guides, step)
        return light

    def _filtered(
        self, light: Float[Tensor, "n 6 h w"], guides: Float[Tensor, "n 7 h w"], step: int
    ) -> Float[Tensor, "n 6 h w"]:
        """A window with the given stride between pixels."""
        side = self.radius * step
        around, guides_around = F.pad(light, [side] * 4), F.pad(guides, [side] * 4)
        height, width = light.shape[-2:]
        total, weights = torch.zeros_like(light), torch.zeros_like(light[:, :2])
        offsets = range(-self.radius, self.radius + 1)
        for dy, dx in product(offsets, offsets):
            rows = slice(side + step * dy, side + step * dy + height)
            columns = slice(side + step * dx, side + step * dx + width)
            weight = self._weight(guides, guides_around[..., rows, columns], dy * dy + dx * dx)  # [N, 2, H, W]
            total = total + weight.repeat_interleave(3, dim=1) * around[..., rows, columns]
            weights = weights + weight
        return total / weights.repeat_interleave(3, dim=1).clamp_min(1e-12)

    @torch.no_grad()
    def _weight(
        self, here: Float[Tensor, "n 7 h w"], there: Float[Tensor, "n 7 h w"], distance2: int
    ) -> Float[Tensor, "n 2 h w"]:
        """Of a neighbour, in either lobe; 0 where it is no surface."""
        (normal, position, roughness), (its_normal, its_position, _) = (
            x.split([3, 3, 1], dim=1) for x in (here, there)
        )
        way = its_position - position
        off_plane = torch.maximum((way * normal).sum(1).abs(), (way * its_normal).sum(1).abs()) / self.plane
        turned = (its_normal - normal).square().sum(1) / self.normal**2
        seen = its_normal.square().sum(1) > 0
        alike = torch.exp(-0.5 * (off_plane.square() + turned)) * seen
        glossy = self.SHARPEST + (self.spread - self.SHARPEST) * roughness[:, 0]
        spreads = torch.stack([torch.full_like(glossy, self.spread), glossy], dim=1)
        weights: Tensor = alike[:, None] * torch.exp(-0.5 * distance2 / spreads.square())
        return weights

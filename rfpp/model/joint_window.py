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
        side, (height, width) = self.radius * step, light.shape[-2:]
        around = F.pad(light.unflatten(1, (2, 3)), [side] * 4)
        guides_around = F.pad(guides, [side] * 4)
        seen = guides_around[:, :3].square().sum(1, keepdim=True) > 0

        def moved(of_all: Tensor, dy: int, dx: int) -> Tensor:
            """What pixels find so many strides away, of an image with a margin."""
            top, left = side + step * dy, side + step * dx
            return of_all[..., top : top + height, left : left + width]

        near = self._near(guides[:, 6])
        weights = moved(seen, 0, 0) * torch.ones_like(near[0])
        total = weights[:, :, None] * moved(around, 0, 0)
        for dy, dx in self._half_window():
            # how alike two pixels are does not depend on which of them asks
            alike = self._alike(guides_around, step * dy, step * dx)
            for sign, away in ((1, (0, 0)), (-1, (-dy, -dx))):
                there = (sign * dy, sign * dx)
                weight = moved(alike, *away) * moved(seen, *there) * near[dy * dy + dx * dx]
                total = torch.addcmul(total, weight[:, :, None], moved(around, *there))
                weights = weights + weight
        return (total / weights[:, :, None].clamp_min(1e-12)).flatten(1, 2)

    def _half_window(self) -> list[tuple[int, int]]:
        """Offsets of the neighbours below, and of those to the right; the others are their opposites."""
        across = range(-self.radius, self.radius + 1)
        return [(dy, dx) for dy, dx in product(range(self.radius + 1), across) if (dy, dx) > (0, 0)]

    @torch.no_grad()
    def _near(self, roughness: Float[Tensor, "n h w"]) -> dict[int, Float[Tensor, "n 2 h w"]]:
        """Weights of either lobe by the squared distance in pixels."""
        glossy = self.SHARPEST + (self.spread - self.SHARPEST) * roughness
        spreads = torch.stack([torch.full_like(glossy, self.spread), glossy], dim=1)
        distances = {dy * dy + dx * dx for dy, dx in self._half_window()}
        return {distance: torch.exp(-0.5 * distance / spreads.square()) for distance in (0, *distances)}

    @torch.no_grad()
    def _alike(self, guides: Float[Tensor, "n 7 h w"], dy: int, dx: int) -> Float[Tensor, "n 1 height w"]:
        """Weights of pixels and those so far below (dy ≥ 0) and to the right of them, as far as there are any.

        Of whole rows: 0 where there is none.
        """
        height, width = guides.shape[-2:]
        left, right = max(-dx, 0), max(dx, 0)
        here = guides[..., : height - dy, left : width - right]
        there = guides[..., dy:, right : width - left]
        (normal, position), (its_normal, its_position) = (x[:, :6].chunk(2, dim=1) for x in (here, there))
        way = its_position - position
        off_plane = torch.maximum((way * normal).sum(1).abs(), (way * its_normal).sum(1).abs()) / self.plane
        turned = (its_normal - normal).square().sum(1) / self.normal**2
        return F.pad(torch.exp(-0.5 * (off_plane.square() + turned))[:, None], [left, right])

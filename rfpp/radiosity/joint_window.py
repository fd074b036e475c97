"""Joint bilateral filter of gathered light."""

from __future__ import annotations

from itertools import product

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


class JointWindow:
    """Weighted mean over a square window, with weights from the G-buffer alone, so that it is linear in light.

    Neighbors count that face the same direction and lie in one plane. For glossy light the window narrows with
    roughness, so that mirrors stay sharp. Larger images are filtered again with strides 2, 4, …, so that the same
    share of the image is covered at any resolution ("à trous", Dammertz et al. 2010).

    Args:
        reach: Share of the image's longer side that all passes together may span to each side. There is always one
            pass, and a second from 120 pixels on.
        normal: Difference of unit normals at which a weight has fallen to e^-1/2.
        plane: Distance from the neighbor's tangent plane in world units, likewise.
        spread: Distance in pixels, likewise, for diffuse light, and for glossy light at roughness 1.
    """

    channels: tuple[str, ...] = ("normal", "position", "roughness")
    #: Distance in pixels at which a mirror's weight has fallen to e^-1/2.
    SHARPEST = 0.3

    def __init__(
        self, radius: int = 2, reach: float = 0.05, normal: float = 0.3, plane: float = 0.01, spread: float = 2.0
    ):
        self.radius, self.reach = radius, reach
        self.normal, self.plane, self.spread = normal, plane, spread

    def __call__(self, light: Float[Tensor, "n 6 h w"], guides: Float[Tensor, "n 7 h w"]) -> Float[Tensor, "n 6 h w"]:
        """Return diffuse and glossy light, each filtered."""
        step, spanned = 1, self.radius
        light = self._filtered(light, guides, step)
        while (spanned := spanned + 2 * step * self.radius) <= self.reach * max(light.shape[-2:]):
            step *= 2
            light = self._filtered(light, guides, step)
        return light

    def _filtered(
        self, light: Float[Tensor, "n 6 h w"], guides: Float[Tensor, "n 7 h w"], step: int
    ) -> Float[Tensor, "n 6 h w"]:
        side, (height, width) = self.radius * step, light.shape[-2:]
        around = F.pad(light.unflatten(1, (2, 3)), [side] * 4)
        guides_around = F.pad(guides, [side] * 4)
        seen = guides_around[:, :3].square().sum(1, keepdim=True) > 0

        def moved(of_all: Tensor, dy: int, dx: int) -> Tensor:
            """Shift a padded image by whole strides."""
            top, left = side + step * dy, side + step * dx
            return of_all[..., top : top + height, left : left + width]

        near = self._near(guides[:, 6])
        weights = moved(seen, 0, 0) * torch.ones_like(near[0])
        total = weights[:, :, None] * moved(around, 0, 0)
        for dy, dx in self._half_window():
            # similarity is symmetric, so each pair is computed once
            alike = self._alike(guides_around, step * dy, step * dx)
            for sign, away in ((1, (0, 0)), (-1, (-dy, -dx))):
                there = (sign * dy, sign * dx)
                weight = moved(alike, *away) * moved(seen, *there) * near[dy * dy + dx * dx]
                total = torch.addcmul(total, weight[:, :, None], moved(around, *there))
                weights = weights + weight
        return (total / weights[:, :, None].clamp_min(1e-12)).flatten(1, 2)

    def _half_window(self) -> list[tuple[int, int]]:
        """Return the offsets of one half of the window; the others are their opposites."""
        across = range(-self.radius, self.radius + 1)
        return [(dy, dx) for dy, dx in product(range(self.radius + 1), across) if (dy, dx) > (0, 0)]

    @torch.no_grad()
    def _near(self, roughness: Float[Tensor, "n h w"]) -> dict[int, Float[Tensor, "n 2 h w"]]:
        """Return the weights of both lobes by squared distance in pixels."""
        glossy = self.SHARPEST + (self.spread - self.SHARPEST) * roughness
        spreads = torch.stack([torch.full_like(glossy, self.spread), glossy], dim=1)
        distances = {dy * dy + dx * dx for dy, dx in self._half_window()}
        return {distance: torch.exp(-0.5 * distance / spreads.square()) for distance in (0, *distances)}

    @torch.no_grad()
    def _alike(self, guides: Float[Tensor, "n 7 h w"], dy: int, dx: int) -> Float[Tensor, "n 1 height w"]:
        """Return the similarity of each pixel and the one at (dy ≥ 0, dx) from it; zero where there is none."""
        height, width = guides.shape[-2:]
        left, right = max(-dx, 0), max(dx, 0)
        here = guides[..., : height - dy, left : width - right]
        there = guides[..., dy:, right : width - left]
        (normal, position), (its_normal, its_position) = (x[:, :6].chunk(2, dim=1) for x in (here, there))
        offset = its_position - position
        off_plane = torch.maximum((offset * normal).sum(1).abs(), (offset * its_normal).sum(1).abs()) / self.plane
        turned = (its_normal - normal).square().sum(1) / self.normal**2
        return F.pad(torch.exp(-0.5 * (off_plane.square() + turned))[:, None], [left, right])

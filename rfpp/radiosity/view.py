"""Inputs of radiosity for one camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.radiosity.sample_means import means


@dataclass(frozen=True)
class View:
    """G-buffer and rays to cells of one camera, H × W pixels with `points` × `points` samples each.

    Attributes:
        channels: G-buffer channel name to its values at samples, linear.
        diffuse: Rows of the cells in which S cosine-distributed rays of each pixel end.
        glossy: Rows of the cells in which rays distributed like the glossy lobe end.
        diffuse_onward: Rows of the cells that the glossy lobe sees from where the diffuse rays end.
        glossy_onward: The same for the glossy rays.
        bounced: Irradiance / π from the surfaces that the diffuse rays hit, as the emitters light them.
        fov: Full angle in degrees along the longer image side.
        points: Samples along each side of a pixel.
    """

    channels: Mapping[str, Float[Tensor, "c height width"]]
    diffuse: Int[Tensor, "s h w"]
    glossy: Int[Tensor, "s h w"]
    diffuse_onward: Int[Tensor, "s h w"]
    glossy_onward: Int[Tensor, "s h w"]
    bounced: Float[Tensor, "3 h w"]
    fov: float
    points: int

    def samples(self, *names: str) -> Float[Tensor, "c height width"]:
        """Return the named channels at samples, stacked."""
        return torch.cat([self.channels[name] for name in names])

    def pixels(self, names: Sequence[str]) -> Float[Tensor, "1 c h w"]:
        """Return the named channels averaged over pixels, stacked."""
        return means(self.samples(*names)[None], self.points)

    def direct_only(self, cells: int) -> View:
        """Return the view without reflections and bounced light, for a scene of C cells."""
        escaped = torch.full_like(self.diffuse, cells)
        dark = {"reflected_light": torch.zeros_like(self.channels["reflected_light"])}
        return replace(
            self,
            channels={**self.channels, **dark},
            diffuse=escaped,
            glossy=escaped,
            diffuse_onward=escaped,
            glossy_onward=escaped,
            bounced=torch.zeros_like(self.bounced),
        )

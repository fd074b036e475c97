"""Ray bundles: the primary rays of a patch of pixels and their G-buffer, embedded as one token (paper, Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.imaging.radiance import log_encode
from rfpp.model.layers.block import FLOAT32_EPS, RMSNorm
from rfpp.raycast.first_hit import CHANNELS, LIGHT_CHANNELS


def ray_directions(fov: Float[Tensor, " n"], height: int, width: int) -> Float[Tensor, "n 3 h w"]:
    """Return unit directions [N, 3, H, W] through the pixel centers, in camera space (see `rfpp.scene.camera`)."""
    rows, columns = (torch.arange(n, dtype=torch.float32, device=fov.device) for n in (height, width))
    x, y = columns + 0.5 - width / 2, height / 2 - rows - 0.5  # pixels from the image's center
    plane = torch.stack([x.expand(height, width), y[:, None].expand(height, width)]) / (max(height, width) / 2)
    xy = plane * torch.tan(torch.deg2rad(fov) / 2)[:, None, None, None]
    return F.normalize(torch.cat([xy, -torch.ones_like(xy[:, :1])], dim=1), dim=1)


class RayBundleEmbedding(nn.Module):
    """Learned token + RMS(Linear(rays and G-buffer of a patch's pixels)).

    Light among the channels enters as log10(1 + light / exposure).

    Args:
        width: Token width D.
        patch_size: Pixels along a patch's side.
        gbuffer_channels: Names from `rfpp.raycast.first_hit.CHANNELS` in the order the batch stacks them; empty for
            the decoder without geometry guidance.
    """

    def __init__(self, width: int, patch_size: int, gbuffer_channels: Sequence[str]):
        super().__init__()
        self.patch_size = patch_size
        self.gbuffer_channels = tuple(gbuffer_channels)
        channels = 3 + sum(self._sizes)
        self.proj = nn.Linear(channels * patch_size**2, width)
        self.norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.token = nn.Parameter(torch.empty(width).normal_(std=0.02))

    def forward(
        self, fov: Float[Tensor, " n"], gbuffer: Float[Tensor, "n c h w"], exposure: Float[Tensor, " n"]
    ) -> Float[Tensor, "n patches width"]:
        """Embed N views.

        Raises:
            ValueError: If the image does not divide into patches, or the G-buffer has other channels than named.
        """
        height, width = gbuffer.shape[-2:]
        if height % self.patch_size or width % self.patch_size:
            raise ValueError(f"{width}×{height} pixels do not divide into patches of {self.patch_size}")
        if gbuffer.shape[1] != sum(self._sizes):
            raise ValueError(f"{gbuffer.shape[1]} G-buffer channels where {self.gbuffer_channels} were expected")
        pixels = torch.cat([ray_directions(fov, height, width), *self._encoded(gbuffer, exposure)], dim=1)
        patches = F.pixel_unshuffle(pixels, self.patch_size).flatten(2).transpose(1, 2)  # [N, patches, (c row column)]
        tokens: Tensor = self.token + self.norm(self.proj(patches))
        return tokens

    def _encoded(self, gbuffer: Float[Tensor, "n c h w"], exposure: Float[Tensor, " n"]) -> list[Tensor]:
        unit = exposure[:, None, None, None]
        parts = zip(self.gbuffer_channels, gbuffer.split(self._sizes, dim=1), strict=True)
        return [log_encode(part / unit) if name in LIGHT_CHANNELS else part for name, part in parts]

    @property
    def _sizes(self) -> list[int]:
        return [CHANNELS[name] for name in self.gbuffer_channels]

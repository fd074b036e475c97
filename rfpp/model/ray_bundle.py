"""Ray bundles: the primary rays of a patch of pixels, with what they hit first, as one token (paper, Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.block import FLOAT32_EPS, RMSNorm
from rfpp.model.view_channels import SIZES
from rfpp.scene.camera import pixel_plane
from rfpp.segments import on_device


def ray_directions(fov: Float[Tensor, " n"], height: int, width: int) -> Float[Tensor, "n 3 h w"]:
    """[N, 3, H, W] unit directions through the pixel centres, in camera space (see rfpp.scene.camera)."""
    plane = on_device(pixel_plane(height, width), fov.device).permute(2, 0, 1)
    xy = plane * torch.tan(torch.deg2rad(fov) / 2)[:, None, None, None]
    return F.normalize(torch.cat([xy, -torch.ones_like(xy[:, :1])], dim=1), dim=1)


class RayBundleEmbedding(nn.Module):
    """Learned token + RMS(Linear(rays and G-buffer of a patch's pixels)).

    Args:
        width: token width.
        patch_size: pixels along a patch's side.
        gbuffer_channels: names from rfpp.model.view_channels.SIZES in the order the batch stacks them; empty
            for the decoder without geometry guidance.
    """

    def __init__(self, width: int, patch_size: int, gbuffer_channels: Sequence[str]):
        super().__init__()
        self.patch_size = patch_size
        self.gbuffer_channels = tuple(gbuffer_channels)
        channels = 3 + sum(SIZES[name] for name in self.gbuffer_channels)
        self.proj = nn.Linear(channels * patch_size**2, width)
        self.norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.token = nn.Parameter(torch.empty(width).normal_(std=0.02))

    def forward(self, fov: Float[Tensor, " n"], gbuffer: Float[Tensor, "n c h w"]) -> Float[Tensor, "n patches width"]:
        """Raises ValueError when the image does not divide into patches."""
        height, width = gbuffer.shape[-2:]
        if height % self.patch_size or width % self.patch_size:
            raise ValueError(f"{width}×{height} pixels do not divide into patches of {self.patch_size}")
        pixels = torch.cat([ray_directions(fov, height, width), gbuffer], dim=1)
        patches = F.pixel_unshuffle(pixels, self.patch_size).flatten(2).transpose(1, 2)  # [N, patches, (c row column)]
        tokens: Tensor = self.token + self.norm(self.proj(patches))
        return tokens


class CameraOrigin:
    """Ray tokens stand at the camera, the origin of camera space: position zero, nothing to rotate (the paper's)."""

    channels: tuple[str, ...] = ()

    def __call__(self, gbuffer: Float[Tensor, "n 0 h w"], patch_size: int) -> None:
        return None


class FirstHitPosition:
    """Ray tokens stand where their rays arrive: the patch's mean first-hit position, in camera space.

    Not in the paper. RSPE then gives each patch its position relative to every object and light, which from the
    camera's origin it would have to work out.
    """

    #: What it needs of the G-buffer, besides what the tokens embed.
    channels: tuple[str, ...] = ("position",)

    def __call__(self, gbuffer: Float[Tensor, "n 3 h w"], patch_size: int) -> Float[Tensor, "n_patches 9"]:
        """[N · patches, 9] the mean position three times; zero where a patch hits nothing."""
        hit = (gbuffer[:, 2:] < 0).float()  # what the camera sees lies at negative z
        mean = F.avg_pool2d(gbuffer, patch_size) / F.avg_pool2d(hit, patch_size).clamp(min=1e-6)
        return mean.flatten(2).transpose(1, 2).flatten(0, 1).repeat(1, 3)

"""What the surroundings of a pixel say of its light: bounded factors at the resolution of the image."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.gbuffer.first_hit import CHANNELS
from rfpp.model.autocast import in_float32


class PixelFactors(nn.Module):
    """exp(γ tanh(map)) of known and gathered light of either lobe, by convolutions over materials and normals.

    Not in the paper. Tokens of 4 × 4 pixels are too coarse for what is wrong with known and gathered light where
    surfaces meet. Factors know no light: the image stays linear in the lights.

    Args:
        width: channels within.
        bound: γ.
    """

    #: What it needs of the G-buffer.
    channels: tuple[str, ...] = ("albedo", "specular", "roughness", "normal")
    #: One for each kind of light: known and gathered, of the diffuse and the glossy lobe.
    KINDS = 4

    def __init__(self, width: int, bound: float):
        super().__init__()
        self.bound = bound
        self.features = nn.Sequential(
            nn.Conv2d(sum(CHANNELS[name] for name in self.channels), width, 1),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.SiLU(),
        )
        self.maps = nn.Conv2d(width, self.KINDS, 1)
        nn.init.normal_(self.maps.weight, std=1e-3)  # starts about as the light is known and gathered
        nn.init.zeros_(self.maps.bias)  # type: ignore[arg-type]

    def forward(
        self, guides: Float[Tensor, "n guides h w"]
    ) -> tuple[Float[Tensor, "n 6 h w"], Float[Tensor, "n 6 h w"]]:
        """Factors of the known and of the gathered light, diffuse before glossy, the same for red, green and blue.

        Args:
            guides: `channels`, of pixels.
        """
        maps = self.maps(self.features(guides))
        with in_float32(maps):
            factors = torch.exp(self.bound * torch.tanh(maps.float()))
        known, gathered = factors.repeat_interleave(3, dim=1).chunk(2, dim=1)
        return known, gathered

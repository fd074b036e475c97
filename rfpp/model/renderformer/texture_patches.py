"""Triangle tokens of the released RenderFormer, whose material enters as a texture patch."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.model.layers.block import FLOAT32_EPS, RMSNorm
from rfpp.model.layers.encoding import FrequencyEncoding
from rfpp.scene.texture import FLAT_NORMAL, TEXTURE_CHANNELS, covered_cells


class TexturePatchEmbedding(nn.Module):
    """Embed triangles whose material is a texture patch of 13 channels.

    The channels are diffuse 3, specular 3, roughness 1, normal 3, log10(1 + emitted radiance) 3. The patch is square
    with the triangle in its upper left half. Where a scene has one material per triangle, the patches are constant, so
    the linear layer over 13 · P² cells is summed exactly into one over 13 values and no patch is built.

    Args:
        width: Token width D.
        normal_frequencies: Frequencies of the normals' encoding.
        patch_size: P, cells along a patch's side.
    """

    flat_normal: Tensor
    covered: Tensor

    def __init__(self, width: int, normal_frequencies: int, patch_size: int):
        super().__init__()
        self.token = nn.Parameter(torch.empty(width).normal_(std=0.02))
        self.texture_proj = nn.Linear(TEXTURE_CHANNELS * patch_size**2, width)
        self.texture_norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.normal_encoding = FrequencyEncoding(normal_frequencies)
        self.normal_proj = nn.Linear(self.normal_encoding.dim(9), width)
        self.normal_norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.register_buffer("flat_normal", torch.tensor(FLAT_NORMAL), persistent=False)
        self.register_buffer("covered", torch.from_numpy(covered_cells(patch_size)), persistent=False)

    def forward(self, batch: RaggedBatch) -> Float[Tensor, "m width"]:
        texture = self._constant(batch) if batch.texture is None else self._varying(batch.texture)
        normals = self.normal_proj(self.normal_encoding(batch.normals.flatten(1)))
        tokens: Tensor = self.token + self.texture_norm(texture) + self.normal_norm(normals)
        return tokens

    def _constant(self, batch: RaggedBatch) -> Float[Tensor, "m width"]:
        cells = self.texture_proj.weight.unflatten(1, (TEXTURE_CHANNELS, *self.covered.shape))
        weight = (cells * self.covered).sum((-1, -2))
        flat = self.flat_normal.expand(len(batch.material), 3)
        values = torch.cat([batch.material[:, :7], flat, batch.log_emission], dim=-1)
        return F.linear(values, weight, self.texture_proj.bias)

    def _varying(self, texture: Float[Tensor, "m 13 p p"]) -> Float[Tensor, "m width"]:
        encoded = torch.cat([texture[:, :10], log_encode(texture[:, 10:])], dim=1)
        projected: Tensor = self.texture_proj(encoded.flatten(1))
        return projected

"""Triangle tokens: what a triangle is made of and how it is shaded; where it stands enters through RSPE only."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_encode
from rfpp.model.block import FLOAT32_EPS, RMSNorm
from rfpp.model.encoding import FrequencyEncoding
from rfpp.scene.texture import FLAT_NORMAL, TEXTURE_CHANNELS, covered_cells

MATERIAL_CHANNELS = 10


class TriangleEmbedding(nn.Module):
    """Learned token + RMS(Linear(material)) + RMS(Linear(frequency-encoded vertex normals)) (paper, Sec. 3.2).

    Emitted radiance enters as log10(1 + e): it spans four orders of magnitude. Raises UserError for textured triangles.
    """

    #: Whether what triangles emit makes a difference.
    reads_emission = True

    def __init__(self, width: int, normal_frequencies: int):
        super().__init__()
        self.token = nn.Parameter(torch.empty(width).normal_(std=0.02))
        self.material_proj = nn.Linear(MATERIAL_CHANNELS, width)
        self.material_norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.normal_encoding = FrequencyEncoding(normal_frequencies)
        self.normal_proj = nn.Linear(self.normal_encoding.dim(9), width)
        self.normal_norm = RMSNorm(width, eps=FLOAT32_EPS)

    def forward(self, batch: RaggedBatch) -> Float[Tensor, "m width"]:
        if batch.texture is not None:
            raise UserError(f"{batch.keys[0]}: textured triangles, but this network knows one material per triangle")
        material = self.material_proj(torch.cat([batch.material[:, :7], self._emission(batch)], dim=-1))
        normals = self.normal_proj(self.normal_encoding(batch.normals.flatten(1)))
        tokens: Tensor = self.token + self.material_norm(material) + self.normal_norm(normals)
        return tokens

    def _emission(self, batch: RaggedBatch) -> Float[Tensor, "m 3"]:
        return batch.log_emission


class LightlessEmbedding(TriangleEmbedding):
    """As TriangleEmbedding, of geometry and reflectance alone, for networks that are linear in light."""

    reads_emission = False

    def _emission(self, batch: RaggedBatch) -> Float[Tensor, "m 3"]:
        return torch.zeros_like(batch.log_emission)


class TexturePatchEmbedding(nn.Module):
    """Triangle tokens of the released RenderFormer: the material enters as a texture patch of 13 channels.

    The channels are diffuse 3, specular 3, roughness 1, normal 3, log10(1 + emitted radiance) 3; the patch is square
    with the triangle in its upper left half. Where a scene has one material per triangle the patches are constant
    there, so the linear layer over 13 · P² cells is summed exactly into one over 13 values, and no patch is ever made.

    Args:
        width: token width.
        normal_frequencies: of the vertex normals' encoding.
        patch_size: P, cells along a patch's side.
    """

    reads_emission = True
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

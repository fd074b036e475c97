"""Triangle tokens: what a triangle is made of and how it is shaded; where it stands enters through RSPE only."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.model.block import RMSNorm
from rfpp.model.encoding import FrequencyEncoding

MATERIAL_CHANNELS = 10


class TriangleEmbedding(nn.Module):
    """Learned token + RMS(Linear(material)) + RMS(Linear(frequency-encoded vertex normals)) (paper, Sec. 3.2).

    Emitted radiance enters as log10(1 + e): it spans four orders of magnitude.
    """

    def __init__(self, width: int, normal_frequencies: int):
        super().__init__()
        self.token = nn.Parameter(0.02 * torch.randn(width))
        self.material_proj = nn.Linear(MATERIAL_CHANNELS, width)
        self.material_norm = RMSNorm(width, eps=None)
        self.normal_encoding = FrequencyEncoding(normal_frequencies)
        self.normal_proj = nn.Linear(self.normal_encoding.dim(9), width)
        self.normal_norm = RMSNorm(width, eps=None)

    def forward(self, batch: RaggedBatch) -> Float[Tensor, "m width"]:
        reflectance = batch.material[:, :7]
        material = self.material_proj(torch.cat([reflectance, batch.log_emission], dim=-1))
        normals = self.normal_proj(self.normal_encoding(batch.normals.flatten(1)))
        return self.token + self.material_norm(material) + self.normal_norm(normals)

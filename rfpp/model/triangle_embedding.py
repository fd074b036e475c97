"""Triangle tokens (paper, Sec. 3.2): material and shading normals; position enters through RSPE only."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.model.layers.block import FLOAT32_EPS, RMSNorm
from rfpp.model.layers.encoding import FrequencyEncoding
from rfpp.ranges import Positive

MATERIAL_CHANNELS = 10


class TriangleEmbedding(nn.Module):
    """Learned token + RMS(Linear(material)) + RMS(Linear(frequency-encoded vertex normals)).

    Emitted radiance enters as log10(1 + e), because it spans four orders of magnitude.

    Args:
        width: Token width D.
        normal_frequencies: Frequencies of the normals' encoding.

    Raises:
        UserError: In `forward`, for textured triangles.
    """

    def __init__(self, width: Positive, normal_frequencies: Positive):
        super().__init__()
        self.token = nn.Parameter(torch.empty(width).normal_(std=0.02))
        self.material_proj = nn.Linear(MATERIAL_CHANNELS, width)
        self.material_norm = RMSNorm(width, eps=FLOAT32_EPS)
        self.normal_encoding = FrequencyEncoding(normal_frequencies)
        self.normal_proj = nn.Linear(self.normal_encoding.dim(9), width)
        self.normal_norm = RMSNorm(width, eps=FLOAT32_EPS)

    def forward(self, batch: RaggedBatch) -> Float[Tensor, "m width"]:
        if batch.texture is not None:
            raise UserError(f"{batch.keys[0]}: textured triangles, but this network takes one material per triangle")
        material = self.material_proj(torch.cat([batch.material[:, :7], batch.log_emission], dim=-1))
        normals = self.normal_proj(self.normal_encoding(batch.normals.flatten(1)))
        tokens: Tensor = self.token + self.material_norm(material) + self.normal_norm(normals)
        return tokens

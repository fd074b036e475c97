"""World space → camera space."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor


def to_camera(points: Float[Tensor, "n k 3"], c2w: Float[Tensor, "n 4 4"]) -> Float[Tensor, "n k 3"]:
    """Transform K world-space points for each of N cameras to camera space."""
    offset = points - c2w[:, None, :3, 3]
    # Rᵀ (p − t), written out because autocast would round a matrix product of positions to bfloat16
    return (offset[..., :, None] * c2w[:, None, :3, :3]).sum(-2)

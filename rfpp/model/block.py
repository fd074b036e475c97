"""The transformer parts everything is built from: pre-norm RMS blocks with QK-norm and SwiGLU, no biases."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.attention import AttentionPattern, attend
from rfpp.model.encoding import Rotation, rotate

NORM_EPS = 1e-6


class RMSNorm(nn.RMSNorm):
    """RMS norm that keeps its input's dtype; a weight of another dtype would leave the fused kernel."""

    def __init__(self, width: int, eps: float | None = NORM_EPS):
        super().__init__(width, eps=eps)

    def forward(self, x: Tensor) -> Tensor:
        return F.rms_norm(x, self.normalized_shape, self.weight.to(x.dtype), self.eps)


class SelfAttention(nn.Module):
    """Multi-head self-attention over packed tokens; QK-norm on the full width, then rotation per head."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.in_proj = nn.Linear(width, 3 * width, bias=False)
        self.q_norm = RMSNorm(width)
        self.k_norm = RMSNorm(width)
        self.out_proj = nn.Linear(width, width, bias=False)

    def forward(
        self, x: Float[Tensor, "n width"], pattern: AttentionPattern, rotation: Rotation | None
    ) -> Float[Tensor, "n width"]:
        q, k, v = self.in_proj(x).chunk(3, dim=-1)
        q = rotate(_split(self.q_norm(q), self.heads), rotation)
        k = rotate(_split(self.k_norm(k), self.heads), rotation)
        return self.out_proj(attend(q, k, _split(v, self.heads), pattern).flatten(1))


class CrossAttention(nn.Module):
    """Multi-head cross-attention over packed tokens.

    Keys and values are projected apart from the attention itself, so that several views can share them.
    """

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.q_proj = nn.Linear(width, width, bias=False)
        self.kv_proj = nn.Linear(width, 2 * width, bias=False)
        self.q_norm = RMSNorm(width)
        self.k_norm = RMSNorm(width)
        self.out_proj = nn.Linear(width, width, bias=False)

    def project(self, context: Float[Tensor, "n width"]) -> tuple[Float[Tensor, "n h d"], Float[Tensor, "n h d"]]:
        """Unrotated keys and values of the context tokens."""
        k, v = self.kv_proj(context).chunk(2, dim=-1)
        return _split(self.k_norm(k), self.heads), _split(v, self.heads)

    def forward(
        self,
        x: Float[Tensor, "n width"],
        keys: Float[Tensor, "m h d"],
        values: Float[Tensor, "m h d"],
        pattern: AttentionPattern,
        rotation: Rotation | None,
    ) -> Float[Tensor, "n width"]:
        """`keys` are already rotated; `rotation` is that of the queries."""
        q = rotate(_split(self.q_norm(self.q_proj(x)), self.heads), rotation)
        return self.out_proj(attend(q, keys, values, pattern).flatten(1))


class SwiGLU(nn.Module):
    """W2(silu(W1 x) · W3 x), with W1 and W3 in one product."""

    def __init__(self, width: int, hidden: int):
        super().__init__()
        self.in_proj = nn.Linear(width, 2 * hidden, bias=False)
        self.out_proj = nn.Linear(hidden, width, bias=False)

    def forward(self, x: Float[Tensor, "n width"]) -> Float[Tensor, "n width"]:
        gate, value = self.in_proj(x).chunk(2, dim=-1)
        return self.out_proj(F.silu(gate) * value)


class SelfBlock(nn.Module):
    """x += attention(norm x); x += SwiGLU(norm x)."""

    def __init__(self, width: int, heads: int, hidden: int):
        super().__init__()
        self.attention_norm, self.attention = RMSNorm(width), SelfAttention(width, heads)
        self.feed_forward_norm, self.feed_forward = RMSNorm(width), SwiGLU(width, hidden)

    def forward(self, x: Tensor, pattern: AttentionPattern, rotation: Rotation | None) -> Tensor:
        x = x + self.attention(self.attention_norm(x), pattern, rotation)
        return x + self.feed_forward(self.feed_forward_norm(x))


class CrossBlock(nn.Module):
    """x += cross-attention(norm x, norm context); x += SwiGLU(norm x)."""

    def __init__(self, width: int, heads: int, hidden: int):
        super().__init__()
        self.query_norm, self.context_norm = RMSNorm(width), RMSNorm(width)
        self.attention = CrossAttention(width, heads)
        self.feed_forward_norm, self.feed_forward = RMSNorm(width), SwiGLU(width, hidden)

    def forward(
        self,
        x: Tensor,
        context: Tensor,
        pattern: AttentionPattern,
        rotation: Rotation | None,
        context_rotation: Rotation | None,
    ) -> Tensor:
        keys, values = self.attention.project(self.context_norm(context))
        keys = rotate(keys, context_rotation)
        x = x + self.attention(self.query_norm(x), keys, values, pattern, rotation)
        return x + self.feed_forward(self.feed_forward_norm(x))


def _split(x: Float[Tensor, "n width"], heads: int) -> Float[Tensor, "n h d"]:
    return x.unflatten(-1, (heads, -1))

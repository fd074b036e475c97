"""The transformer parts everything is built from: pre-norm RMS blocks with QK-norm and SwiGLU, no biases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from rfpp.model.layers.attention import AttentionPattern, attend
from rfpp.model.layers.autocast import as_multiplied
from rfpp.model.layers.encoding import Rotation, rotate

NORM_EPS = 1e-6
#: What RenderFormer's embeddings add: PyTorch's default in float32. (In bfloat16 it would be 0.0078.)
FLOAT32_EPS = torch.finfo(torch.float32).eps


class RMSNorm(nn.RMSNorm):
    """nn.RMSNorm, in half the time on a CPU, where PyTorch composes it of many small operations.

    Keeps its input's dtype; the mean square is taken in float32.
    """

    def __init__(self, width: int, eps: float = NORM_EPS):
        super().__init__(width, eps=eps)

    def forward(self, x: Float[Tensor, "*rows width"]) -> Float[Tensor, "*rows width"]:
        if x.is_cuda or torch.compiler.is_compiling():
            return F.rms_norm(x, self.normalized_shape, self.weight.to(x.dtype), self.eps)
        return _normalized_rows(x, self.weight.to(x.dtype), self.eps)


class _NormalizeRows(torch.autograd.Function):
    """x · w / √(mean x² + eps), with its derivative written out.

    Under autocast that needs no more of the normalized rows than what the layers behind get: half their memory.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, eps: float) -> Tensor:
        norm = torch.linalg.vector_norm(x, dim=-1, keepdim=True, dtype=torch.float32)
        inverse = (norm.square() / x.shape[-1] + eps).rsqrt().to(x.dtype)
        unit: Tensor = x * inverse
        ctx.save_for_backward(as_multiplied(unit), inverse, weight)
        return unit * weight

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        unit, inverse, weight = ctx.saved_tensors
        along = grad * unit
        mean = (along @ weight)[..., None] / unit.shape[-1]
        grad_x = torch.addcmul(grad * weight, unit, mean, value=-1) * inverse
        return grad_x, along.flatten(0, -2).sum(0), None


_normalized_rows: Callable[..., Tensor] = _NormalizeRows.apply  # torch's has no types


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
        q, k, v = _linears(x, self.in_proj, 3)
        q = rotate(_split(self.q_norm(q), self.heads), rotation)
        k = rotate(_split(self.k_norm(k), self.heads), rotation)
        out: Tensor = self.out_proj(attend(q, k, _split(v, self.heads), pattern).flatten(1))
        return out


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
        """Return unrotated keys and values of the context tokens."""
        k, v = _linears(context, self.kv_proj, 2)
        return _split(self.k_norm(k), self.heads), _split(v, self.heads)

    def forward(
        self,
        x: Float[Tensor, "n width"],
        keys: Float[Tensor, "m h d"],
        values: Float[Tensor, "m h d"],
        pattern: AttentionPattern,
        rotation: Rotation | None,
    ) -> Float[Tensor, "n width"]:
        """Update queries; `keys` are already rotated, `rotation` belongs to the queries."""
        q = rotate(_split(self.q_norm(self.q_proj(x)), self.heads), rotation)
        out: Tensor = self.out_proj(attend(q, keys, values, pattern).flatten(1))
        return out


class SwiGLU(nn.Module):
    """W2(silu(W1 x) · W3 x), with W1 and W3 in one parameter."""

    def __init__(self, width: int, hidden: int):
        super().__init__()
        self.in_proj = nn.Linear(width, 2 * hidden, bias=False)
        self.out_proj = nn.Linear(hidden, width, bias=False)

    def forward(self, x: Float[Tensor, "n width"]) -> Float[Tensor, "n width"]:
        gate, value = _linears(x, self.in_proj, 2)
        if torch.compiler.is_compiling():  # which decides for itself what to keep
            out: Tensor = self.out_proj(F.silu(gate) * value)
            return out
        return _gated_linear(gate, value, self.out_proj.weight)


class _GatedLinear(torch.autograd.Function):
    """W (silu(gate) · value), which keeps gate and value alone and multiplies them again in the backward pass.

    The product is as wide as either: of the widest layer two thirds are kept, for one elementwise product more. Nor is
    the weight kept as autocast converts it.
    """

    @staticmethod
    def forward(ctx: Any, gate: Tensor, value: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(gate, value, weight)
        return F.linear(F.silu(gate).mul_(value), as_multiplied(weight))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        gate, value, weight = ctx.saved_tensors
        grad_gated, open_gate, grad_weight = grad @ weight.to(grad.dtype), F.silu(gate), None
        if ctx.needs_input_grad[2]:
            product = grad.flatten(0, -2).T @ (open_gate * value).flatten(0, -2)
            grad_weight = product.to(weight.dtype)
        return torch.ops.aten.silu_backward(grad_gated * value, gate), open_gate.mul_(grad_gated), grad_weight


_gated_linear: Callable[..., Tensor] = _GatedLinear.apply  # torch's has no types


class SelfBlock(nn.Module):
    """x += attention(norm x); x += SwiGLU(norm x)."""

    def __init__(self, width: int, heads: int, hidden: int):
        super().__init__()
        self.attention_norm, self.attention = RMSNorm(width), SelfAttention(width, heads)
        self.feed_forward_norm, self.feed_forward = RMSNorm(width), SwiGLU(width, hidden)

    def forward(self, x: Tensor, pattern: AttentionPattern, rotation: Rotation | None) -> Tensor:
        x = x + self.attention(self.attention_norm(x), pattern, rotation)
        out: Tensor = x + self.feed_forward(self.feed_forward_norm(x))
        return out


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
        out: Tensor = x + self.feed_forward(self.feed_forward_norm(x))
        return out


def _split(x: Float[Tensor, "n width"], heads: int) -> Float[Tensor, "n h d"]:
    return cast(Tensor, x.unflatten(-1, (heads, -1)))


def _linears(x: Float[Tensor, "n width"], stacked: nn.Linear, parts: int) -> tuple[Tensor, ...]:
    """Split a bias-free linear layer's output into equal parts.

    A GPU takes them in one product, whose launch costs more than what follows on slices. On a CPU each is contiguous.
    """
    if x.is_cuda:
        product: Tensor = stacked(x)
        return product.chunk(parts, dim=-1)
    x = as_multiplied(x)  # once, not for each part
    return tuple(F.linear(x, weight) for weight in stacked.weight.chunk(parts))

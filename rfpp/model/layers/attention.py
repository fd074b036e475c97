"""Attention over packed sequences of different lengths, behind one function.

`attend(q, k, v, pattern)` lets the rows of query segment i see exactly the rows of key segment i. Three backends
compute the same thing: variable-length kernels on CUDA in half precision, length-bucketed dense attention
elsewhere, and a loop over segments that is slow, obvious, and the yardstick of the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.attention import SDPBackend, sdpa_kernel

from rfpp.model.layers.tiled_attention import attend_tiled
from rfpp.segments import Segments, on_device

#: Segments are padded to multiples of this and taken in powers of two. On a CPU every new shape of a matrix product
#: costs a compilation (oneDNN), so the shapes must recur from batch to batch.
GRANULARITY = 32
#: Recurring segments of one length, this long at least, go to dense attention on a GPU, where cuDNN's kernel is faster
#: than FlashAttention's for ragged ones. Planning it takes half a second for each new shape.
DENSE_FROM = 1024
#: Up to this many scores per head are held at once on a CPU in bfloat16, which is faster than computing them twice.
SMALL_ATTENTION = 256 * 256


class AttentionPattern:
    """Mask of packed rows: query segment i sees key segment i.

    Build it once per batch and share it between layers: the index tables below are computed on first use.

    Args:
        queries, keys: segments of the rows; without `keys`, self-attention.
        order: for self-attention, the row that comes first, second, … when the segments are laid out end to end;
            None where that is the order of the rows.
        equal_length: for self-attention, the length of every segment where all are equal and the same from batch to
            batch, as those of the rays of views are; else 0.

    Raises:
        ValueError: the segments do not pair up, or an order is given for cross-attention.
    """

    def __init__(
        self,
        queries: Segments,
        keys: Segments | None = None,
        order: Int[Tensor, " n"] | None = None,
        equal_length: int = 0,
    ):
        if order is not None and keys is not None:
            raise ValueError("`order` requires self-attention")
        keys = queries if keys is None else keys
        if len(queries) != len(keys):
            raise ValueError(f"{len(queries)} query segments for {len(keys)} key segments")
        self.queries, self.keys, self.order = queries, keys, order
        self.longest_query, self.longest_key, self.equal_length = queries.longest, keys.longest, equal_length

    @cached_property
    def inverse_order(self) -> Int[Tensor, " n"]:
        """Return the position of each row in `order`. Raises ValueError where there is none."""
        if self.order is None:
            raise ValueError("these rows are in order")
        return self.order.argsort()

    @cached_property
    def real_keys(self) -> Bool[Tensor, " keys"]:
        """Return which key rows belong to a segment."""
        offsets = self.keys.offsets
        return torch.arange(self.keys.total, device=offsets.device) < offsets[-1]

    @cached_property
    def buckets(self) -> list[Bucket]:
        """Segments grouped by padded key and query length, shortest first, in groups of a power of two."""
        query_lengths, key_lengths = np.array(self.queries.lengths), np.array(self.keys.lengths)
        padded = np.stack([padded_length(query_lengths), padded_length(key_lengths)])
        order = np.lexsort(padded)
        order = order[query_lengths[order] > 0]
        changes = np.flatnonzero((np.diff(padded[:, order]) != 0).any(axis=0)) + 1
        q_starts, k_starts = (np.cumsum(n) - n for n in (query_lengths, key_lengths))
        return [
            Bucket(
                query_rows=_padded_rows(q_starts[members], query_lengths[members], int(padded[0, members[0]])),
                key_rows=_padded_rows(k_starts[members], key_lengths[members], int(padded[1, members[0]])),
            )
            for group in np.split(order, changes)
            for members in _powers_of_two(group)
        ]

    @cached_property
    def query_layout(self) -> PaddedLayout:
        return PaddedLayout([b.query_rows for b in self.buckets], self.queries)

    @cached_property
    def key_layout(self) -> PaddedLayout:
        return PaddedLayout([b.key_rows for b in self.buckets], self.keys)

    @cached_property
    def key_masks(self) -> list[Tensor | None]:
        """Per bucket [b, 1, 1, longest key] bool, True = real; None where nothing is padded."""
        device = self.keys.offsets.device
        rows = [b.key_rows >= 0 for b in self.buckets]
        return [None if real.all() else on_device(real, device)[:, None, None, :] for real in rows]


class Bucket(NamedTuple):
    """Some segments padded to one length: which packed row each padded row is, -1 for padding."""

    query_rows: np.ndarray  # [b, Lq]
    key_rows: np.ndarray  # [b, Lk]


def padded_length(lengths: np.ndarray) -> np.ndarray:
    """Round lengths up to a power of two, above GRANULARITY to a multiple of it."""
    small = 2 ** np.ceil(np.log2(np.maximum(lengths, 1))).astype(int)
    return np.where(lengths <= GRANULARITY, small, -(-lengths // GRANULARITY) * GRANULARITY)


def _powers_of_two(group: np.ndarray) -> Iterator[np.ndarray]:
    """Split a number of segments into powers of two: 13 into 8, 4 and 1."""
    while len(group):
        size = 1 << (len(group).bit_length() - 1)
        yield group[:size]
        group = group[size:]


def _padded_rows(starts: np.ndarray, lengths: np.ndarray, longest: int) -> np.ndarray:
    position = np.arange(longest)
    return np.where(position < lengths[:, None], starts[:, None] + position, -1)


class PaddedLayout:
    """Moves packed rows [N, ...] into the buckets' padded rows and back; both ways are one gather.

    Attributes:
        shapes: (segments, longest) of each bucket.
        padded_from_packed: [padded rows] the packed row of each padded row (row 0 for padding, which is masked).
        packed_from_padded: [N] where each packed row went.
        trivial: the padded rows are the packed rows in the same order, so nothing needs to move.
    """

    def __init__(self, rows: list[np.ndarray], segments: Segments):
        self.shapes = [r.shape for r in rows]
        flat = np.concatenate([r.ravel() for r in rows])
        real = flat >= 0
        inverse = np.empty(sum(segments.lengths), dtype=np.int64)
        inverse[flat[real]] = np.flatnonzero(real)
        self.trivial = bool(len(flat) == len(inverse) and (flat == np.arange(len(flat))).all())
        device = segments.offsets.device
        self.padded_from_packed = on_device(np.where(real, flat, 0), device)
        self.packed_from_padded = on_device(inverse, device)

    def pad(self, x: Tensor) -> list[Tensor]:
        """Pad [N, H, D] to [b, H, L, D] for each bucket."""
        if not self.trivial:
            x = _regather(x, self.padded_from_packed, self.packed_from_padded)
        pieces = x.split([b * length for b, length in self.shapes])
        return [
            p.view(b, length, *p.shape[1:]).transpose(1, 2) for p, (b, length) in zip(pieces, self.shapes, strict=True)
        ]

    def unpad(self, pieces: list[Tensor]) -> Tensor:
        """Unpad [b, H, L, D] of each bucket to [N, H, D]."""
        rows = [p.transpose(1, 2).flatten(0, 1) for p in pieces]
        x = rows[0] if len(rows) == 1 else torch.cat(rows)
        return x if self.trivial else _regather(x, self.packed_from_padded, self.padded_from_packed)


class _Regather(torch.autograd.Function):
    """x[index], whose gradient is grad[inverse]: a gather both ways, where autograd would scatter-add.

    Valid because real rows are a bijection and the gradient of a padding row is zero (masked) or dropped.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, index: Tensor, inverse: Tensor) -> Tensor:
        ctx.save_for_backward(inverse)
        ctx.padding_in_input = len(index) < len(inverse)
        ctx.index = index
        return x.index_select(0, index)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        (inverse,) = ctx.saved_tensors
        if not ctx.padding_in_input:
            return grad.index_select(0, inverse), None, None
        # unpad: padding rows were read by nobody, so their gradient is zero, not that of row 0
        out = grad.new_zeros(len(inverse), *grad.shape[1:])
        return out.index_copy_(0, ctx.index, grad.contiguous()), None, None


_regather: Callable[..., Tensor] = _Regather.apply  # torch's has no types


def attend(
    q: Float[Tensor, "nq h d"], k: Float[Tensor, "nk h d"], v: Float[Tensor, "nk h d"], pattern: AttentionPattern
) -> Float[Tensor, "nq h d"]:
    """Return softmax(q kᵀ / √d) v within each segment, by the fastest backend for device and precision."""
    backend = attend_bucketed
    if has_varlen_kernel(q):
        backend = attend_equal if pattern.equal_length >= DENSE_FROM else attend_varlen
    if pattern.order is None:
        return backend(q, k, v, pattern)
    there, back = pattern.order, pattern.inverse_order
    q, k, v = (_regather(x, there, back) for x in (q, k, v))
    return _regather(backend(q, k, v, pattern), back, there)


def has_varlen_kernel(q: Float[Tensor, "n h d"]) -> bool:
    """Return whether FlashAttention has a kernel for these heads where they are."""
    return q.is_cuda and q.dtype in (torch.float16, torch.bfloat16) and q.shape[-1] % 8 == 0 and q.shape[-1] <= 256


def attend_bucketed(q: Tensor, k: Tensor, v: Tensor, pattern: AttentionPattern) -> Tensor:
    """Compute dense attention per bucket of similar key lengths."""
    if pattern.keys.unowned:
        k, v = (x[: sum(pattern.keys.lengths)] for x in (k, v))
    qs, ks, vs = pattern.query_layout.pad(q), pattern.key_layout.pad(k), pattern.key_layout.pad(v)
    out = [_attend_dense(*qkv, mask) for qkv, mask in zip(zip(qs, ks, vs, strict=True), pattern.key_masks, strict=True)]
    return pattern.query_layout.unpad(out)


def _attend_dense(q: Tensor, k: Tensor, v: Tensor, mask: Tensor | None) -> Tensor:
    """Attend with tensors [b, H, L, D]; `mask` [b, 1, 1, Lk], True = real. Each case uses its fastest kernel."""
    if q.is_cuda or q.dtype == torch.float32:
        return F.scaled_dot_product_attention(q, k, v, attn_mask=mask)
    real = None if mask is None else mask[:, 0].repeat_interleave(q.shape[1], dim=0)
    # copies: the backward pass would keep the rows of all buckets for a view of some
    of_q, of_k, of_v = (x.clone(memory_format=torch.contiguous_format).flatten(0, 1) for x in (q, k, v))
    attend_heads = attend_tiled if q.shape[-2] * k.shape[-2] > SMALL_ATTENTION else _attend_at_once
    out = attend_heads(of_q, of_k, of_v, real)
    return cast(Tensor, out.unflatten(0, q.shape[:2]))


def _attend_at_once(q: Tensor, k: Tensor, v: Tensor, real: Tensor | None) -> Tensor:
    """Attend with tensors [b·H, L, D]; `real` [b·H, 1, Lk], False = padding."""
    scores: Tensor = (q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)
    if real is not None:
        scores = scores.masked_fill(~real, float("-inf"))
    return scores.softmax(dim=-1) @ v


def attend_varlen(q: Tensor, k: Tensor, v: Tensor, pattern: AttentionPattern) -> Tensor:
    """Run FlashAttention's variable-length kernel on the packed rows (CUDA, half precision)."""
    from torch.nn.attention.varlen import varlen_attn

    if pattern.keys.unowned:  # nobody reads those rows, and nobody writes their gradients either
        real = pattern.real_keys[:, None, None]
        k, v = k.where(real, 0), v.where(real, 0)
    offsets = pattern.queries.offsets, pattern.keys.offsets
    out = varlen_attn(q, k, v, *offsets, pattern.longest_query, pattern.longest_key)
    return cast(Tensor, out)  # a pair where log-sum-exps are asked for


def attend_equal(q: Tensor, k: Tensor, v: Tensor, pattern: AttentionPattern) -> Tensor:
    """Compute dense attention in segments of equal length (CUDA, half precision)."""
    heads = [x.unflatten(0, (-1, pattern.equal_length)).transpose(1, 2) for x in (q, k, v)]  # [segments, h, length, d]
    with sdpa_kernel([SDPBackend.CUDNN_ATTENTION, SDPBackend.FLASH_ATTENTION], set_priority=True):
        out: Tensor = F.scaled_dot_product_attention(*heads)
    return out.transpose(1, 2).flatten(0, 1)

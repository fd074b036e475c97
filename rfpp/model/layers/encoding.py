"""Positional encodings: frequency encoding of normals, and RSPE, the rotary encoding of triangle positions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.layers.autocast import as_multiplied


@dataclass(frozen=True)
class Rotation:
    """Cosines and sines of the rotary angles of N tokens: [N, 1, head_dim / 2] each, as products are computed."""

    cos: Float[Tensor, "n 1 half"]
    sin: Float[Tensor, "n 1 half"]


class FrequencyEncoding(nn.Module):
    """[x, sin(f x), sin(f x + π/2)] with f = 2^0 … 2^(F-1) (RenderFormer's encoding of vertex normals).

    Each value's frequencies are contiguous, all sines come before all cosines.
    """

    frequencies: Tensor

    def __init__(self, num_frequencies: int):
        super().__init__()
        self.register_buffer("frequencies", 2.0 ** torch.arange(num_frequencies), persistent=False)

    def dim(self, inputs: int) -> int:
        """Return the encoded size of `inputs` values."""
        return inputs * (1 + 2 * len(self.frequencies))

    def forward(self, x: Float[Tensor, "n c"]) -> Float[Tensor, "n encoded"]:
        angles = (x.float()[..., None] * self.frequencies).flatten(-2)
        return torch.cat([x, angles.sin(), (angles + math.pi / 2).sin()], dim=-1)


class RelativeSpatialEncoding(nn.Module):
    """RSPE: rotary encoding over nine coordinates, three points of a triangle or of an object's anchor.

    Attention scores then depend on position differences only, so a translated scene gives the same result.
    Frequencies are 2^linspace(0, log2 5, F); the 9F angles (coordinate-major) fill the first rotary pairs and the
    remaining ones stay unrotated. Half-split layout, as released (RenderFormer, Sec. 3).

    Raises:
        ValueError: 9F angles do not fit into half a head.
    """

    frequencies: Tensor

    def __init__(self, head_dim: int, num_frequencies: int):
        super().__init__()
        if 9 * num_frequencies > head_dim // 2:
            raise ValueError(
                f"RSPE needs 9·{num_frequencies} rotary pairs but half a head is {head_dim // 2}: "
                f"use at most {head_dim // 18} frequencies or wider heads"
            )
        self.unrotated = head_dim // 2 - 9 * num_frequencies
        self.register_buffer("frequencies", 2.0 ** torch.linspace(0, math.log2(5), num_frequencies), persistent=False)

    def forward(self, points: Float[Tensor, "n 9"]) -> Rotation:
        angles = (points.float()[..., None] * self.frequencies.float()).flatten(-2)
        angles = nn.functional.pad(angles, (0, self.unrotated))[:, None, :]
        return Rotation(as_multiplied(angles.cos()), as_multiplied(angles.sin()))


def rotate(x: Float[Tensor, "n h d"], rotation: Rotation | None) -> Float[Tensor, "n h d"]:
    """Rotate the pairs (x_i, x_{i + d/2}); `None` means position zero, which rotates nothing."""
    if rotation is None:
        return x
    cos, sin = rotation.cos.to(x.dtype), rotation.sin.to(x.dtype)
    if cos.requires_grad or torch.compiler.is_compiling():  # someone optimizes positions, or traces us
        a, b = x.chunk(2, dim=-1)
        return torch.cat([a * cos - b * sin, b * cos + a * sin], dim=-1)
    return _rotated(x, cos, sin)


class _Rotate(torch.autograd.Function):
    """The rotation in place of four temporaries; its derivative turns back."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
        ctx.save_for_backward(cos, sin)
        return _turned(x, cos, sin, 1)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        cos, sin = ctx.saved_tensors
        return _turned(grad, cos, sin, -1), None, None


_rotated: Callable[..., Tensor] = _Rotate.apply  # torch's has no types


def _turned(x: Tensor, cos: Tensor, sin: Tensor, direction: int) -> Tensor:
    out = torch.empty_like(x)
    (a, b), (out_a, out_b) = x.chunk(2, dim=-1), out.chunk(2, dim=-1)
    torch.mul(a, cos, out=out_a).addcmul_(b, sin, value=-direction)
    torch.mul(b, cos, out=out_b).addcmul_(a, sin, value=direction)
    return out

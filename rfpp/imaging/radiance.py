"""Encodings of radiance: the log encoding of networks, the tone map of losses and metrics, and 8-bit sRGB.

Radiance is linear RGB, unbounded above. NaN stays NaN in all encodings, except that it becomes 0 in 8 bits.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, UInt8
from torch import Tensor


def log_encode(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return log10(1 + radiance), the output of networks and the input of the L1 loss."""
    return torch.log1p(radiance) / math.log(10)


def log_decode(log_radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return 10^x - 1, the inverse of `log_encode`, exact near zero."""
    return torch.expm1(log_radiance * math.log(10))


def perceptual(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return clamp(log2(1 + radiance), 0, 1), the tone map of perceptual losses and metrics."""
    return (torch.log1p(radiance) / math.log(2)).clamp(0.0, 1.0)


def exposed(radiance: Float[Tensor, "*shape"], stops: float) -> Float[Tensor, "*shape"]:
    """Return radiance times 2^stops."""
    return radiance * float(2.0**stops)


def srgb(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return display values in [0, 1] by the sRGB curve (IEC 61966-2-1); values above 1 are clipped."""
    linear = linear.clamp(0.0, 1.0)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def linear(display: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return the inverse of `srgb`."""
    return torch.where(display <= 0.04045, display / 12.92, ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def to_8bit(display: Float[Tensor, "*shape"]) -> UInt8[Tensor, "*shape"]:
    """Return display values in [0, 1] as the nearest of 256 levels; NaN becomes 0."""
    return (display.nan_to_num(0.0).clamp(0.0, 1.0) * 255).round().to(torch.uint8)

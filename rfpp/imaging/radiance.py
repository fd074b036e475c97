"""Encodings of radiance: the log encoding the network speaks, the tone map of losses and metrics, and 8-bit PNG.

Radiance is linear RGB, unbounded above. Nothing here repairs its input: a NaN stays a NaN, so that a broken image
is noticed where it was made; only the step to 8-bit integers, which cannot hold one, writes it as black.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, UInt8
from torch import Tensor


def log_encode(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log10(1 + radiance): what the network predicts and what the L1 loss compares."""
    return torch.log1p(radiance) / math.log(10)


def log_decode(log_radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """The inverse of `log_encode`: 10^x - 1, exact near zero."""
    return torch.expm1(log_radiance * math.log(10))


def perceptual(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """The tone map of every perceptual loss and metric: clamp(log2(1 + radiance), 0, 1)."""
    return (torch.log1p(radiance) / math.log(2)).clamp(0.0, 1.0)


def exposed(radiance: Float[Tensor, "*shape"], stops: float) -> Float[Tensor, "*shape"]:
    """Radiance after a change of exposure: one stop doubles it."""
    return radiance * float(2.0**stops)


def srgb(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Display values in [0, 1] of linear light by the sRGB transfer curve (IEC 61966-2-1); brighter than 1 is white."""
    linear = linear.clamp(0.0, 1.0)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def linear(display: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """The inverse of `srgb`."""
    return torch.where(display <= 0.04045, display / 12.92, ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def to_8bit(display: Float[Tensor, "*shape"]) -> UInt8[Tensor, "*shape"]:
    """Display values in [0, 1] as the nearest of 256 levels; NaN becomes 0."""
    return (display.nan_to_num(0.0).clamp(0.0, 1.0) * 255).round().to(torch.uint8)

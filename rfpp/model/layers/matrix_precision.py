"""Precision of a network's matrix products."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import nn

from rfpp.errors import UserError
from rfpp.model.layers.block import CrossAttention, SelfAttention, SwiGLU

#: By the names of settings.
PRECISIONS = {"bf16": torch.bfloat16, "fp32": torch.float32}
#: What a CPU calls its instructions for products in bfloat16.
_CPU_INSTRUCTIONS = ("amx_bf16", "avx512_bf16", "bf16")


def matrix_dtype(precision: str, device: torch.device) -> torch.dtype:
    """Return the dtype of "bf16", "fp32", or "auto": bfloat16 if the device has instructions for it.

    Images in bfloat16 differ from those in float32 by a thirtieth of what both differ from the reference. Raises
    UserError for another setting.
    """
    if precision == "auto":
        return torch.bfloat16 if _multiplies_bfloat16(device) else torch.float32
    if precision not in PRECISIONS:
        raise UserError(f"precision={precision}: choose from auto, {', '.join(PRECISIONS)}")
    return PRECISIONS[precision]


def convert_blocks(network: nn.Module, dtype: torch.dtype) -> None:
    """Store the weights of attention and feed-forward layers, nearly all there are, in the dtype of their products.

    Autocast converts weights in float32 every time they are used. Images stay the same to the last bit.
    """
    for _, part in _layers(network):
        part.to(dtype)


def block_weights(network: nn.Module) -> frozenset[str]:
    """Return the names of the weights of attention and feed-forward layers."""
    return frozenset(f"{layer}.{name}" for layer, part in _layers(network) for name, _ in part.named_parameters())


def _layers(network: nn.Module) -> Iterator[tuple[str, nn.Module]]:
    parts = network.named_modules()
    return ((name, part) for name, part in parts if isinstance(part, SelfAttention | CrossAttention | SwiGLU))


def _multiplies_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.get_device_capability(device) >= (8, 0)
    capabilities = torch.cpu.get_capabilities() if device.type == "cpu" else {}
    return any(capabilities.get(name) for name in _CPU_INSTRUCTIONS)

"""Floating-point operations of a network and published peak rates of GPUs."""

from __future__ import annotations

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode, sdpa_flop_count

from rfpp.batch import RaggedBatch

#: Operations that PyTorch's counter lacks: fused attention on a CPU.
UNKNOWN_TO_COUNTER = {
    torch.ops.aten._scaled_dot_product_flash_attention_for_cpu: lambda q, k, v, *_, **__: sdpa_flop_count(q, k, v)
}
#: Operations per second in dense bfloat16 matrix products, summed in float32, from NVIDIA's data sheets.
#: Longer names come first.
PUBLISHED_PEAKS = {
    "NVIDIA H100 PCIe": 756e12,
    "NVIDIA H100 NVL": 835e12,
    "NVIDIA H100": 989e12,
    "NVIDIA H200": 989e12,
    "NVIDIA B200": 2250e12,
    "NVIDIA A100": 312e12,
    "NVIDIA L40S": 362e12,
    "NVIDIA GeForce RTX 4090": 165e12,
    "NVIDIA GeForce RTX 3090": 71e12,
}


@torch.no_grad()
def training_flops(network: nn.Module, batch: RaggedBatch) -> float:
    """Count the operations of a forward and a backward pass; the latter takes twice as many as the former.

    Runs a forward pass, which changes no random state and compiles nothing. Recomputed activations do not count.
    """
    devices = [batch.positions.device] if batch.positions.is_cuda else []
    counter = FlopCounterMode(display=False, custom_mapping=UNKNOWN_TO_COUNTER)
    with torch.random.fork_rng(devices), torch.compiler.set_stance("force_eager"), counter:
        network(batch)
    return 3.0 * counter.get_total_flops()


def published_peak(device: torch.device, dtype: torch.dtype) -> float | None:
    """Return the vendor's peak rate of this GPU; None if GPU or dtype is not listed."""
    if device.type != "cuda" or dtype != torch.bfloat16:
        return None
    name = torch.cuda.get_device_name(device)
    return next((peak for card, peak in PUBLISHED_PEAKS.items() if name.startswith(card)), None)

"""Check whether a network uses its tokens and its operator, and whether the operator converges."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import torch
from torch import nn

from rfpp.batch import RaggedBatch
from rfpp.losses.ablation import AblationErrors
from rfpp.losses.log_l1 import log_l1
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import select_views


@torch.no_grad()
def ablation_growth(network: nn.Module, split: ShardSplit, device: torch.device, scenes: int) -> dict[str, float]:
    """Measure the relative growth of log-L1 by ablation (`rfpp.losses.ablation`).

    Returns:
        Growth by ablation; empty for fewer than two scenes.
    """
    errors = AblationErrors()
    for batch in _batches(network, split, device, scenes):
        errors.add(network, batch, network(batch).log_radiance)
    return errors.growth()


@torch.no_grad()
def transport_convergence(
    network: nn.Module, split: ShardSplit, device: torch.device, scenes: int
) -> dict[str, list[float]]:
    """Apply the transport operator more often than in training.

    Returns:
        Means over scenes after k = 0 … 2K applications: "residual", the mean |⁽ᵏ⁾F_s − T(⁽ᵏ⁾F_s + F_e)|² of the
        tokens, and "log_l1" of the decoded image. Empty for a network without an operator, or without scenes.
    """
    count = 2 * network.iterations
    if not count or not scenes:
        return {}
    traces = []
    for batch in _batches(network, split, device, scenes):
        encoded, (_, scattered) = network.transported_each(*network.tokenize(batch), count + 1)
        images = [network.view(each, batch.c2w, batch.fov, batch.gbuffer) for each in encoded[:-1]]
        residuals = [(a - b).square().mean().item() for a, b in pairwise(scattered)]
        traces.append((residuals, [log_l1(image, batch.image).item() for image in images]))
    return dict(zip(("residual", "log_l1"), np.mean(traces, axis=0).tolist(), strict=True))


def _batches(network: nn.Module, split: ShardSplit, device: torch.device, scenes: int) -> Iterator[RaggedBatch]:
    for index in range(min(scenes, len(split))):
        sample = split[index]
        yield RaggedBatch.pack([select_views(sample, range(len(sample.fov)), network.gbuffer_channels)]).to(device)

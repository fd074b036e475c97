"""Convergence of a transport operator that is applied repeatedly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import nn

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_decode
from rfpp.metrics.image import log_l1
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.model.renderformer.transport import EncodedTransport
from rfpp.model.pitg import PhysicsInformedTransport
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import select_views


@dataclass(frozen=True, eq=False)
class TransportTrace:
    """The operator applied n times to S scenes. Row k belongs to the image decoded from ⁽ᵏ⁾F_s + F_e.

    Attributes:
        trained: K, the applications it was trained for.
        residual: [n, S] mean |⁽ᵏ⁾F_s − T(⁽ᵏ⁾F_s + F_e)|² of the tokens, k = 0 … n − 1.
        error: [n, S] log-L1 of the decoded images against the reference.
        change: [n, S] log-L1 between the images decoded from k and from k + 1.
        radiance: [n, R, H, W, 3] the first view of the first R scenes.
        reference: [R, H, W, 3] linear radiance.
    """

    trained: int
    residual: Float[np.ndarray, "n s"]
    error: Float[np.ndarray, "n s"]
    change: Float[np.ndarray, "n s"]
    radiance: Float[np.ndarray, "n r h w 3"]
    reference: Float[np.ndarray, "r h w 3"]


@torch.no_grad()
def trace_transport(
    network: nn.Module,
    split: ShardSplit,
    applications: int,
    pictured_scenes: int,
    device: torch.device,
    on_scene: Callable[[], None] = lambda: None,
) -> TransportTrace:
    """Apply a network's operator up to `applications` times to every scene of a split, decoding after each.

    Args:
        network: in evaluation mode, on `device`.
        pictured_scenes: R, scenes whose images are kept.
        on_scene: called after each scene, for a progress bar.

    Raises:
        UserError: the network has no operator.
    """
    operator = operator_of(network)
    traces, images, references = [], [], []
    for index in range(len(split)):
        sample = split[index]
        views = select_views(sample, range(len(sample.fov)), network.gbuffer_channels)
        batch = RaggedBatch.pack([views]).to(device)
        decoded, residual = _decoded(network, batch, applications)
        error = torch.stack([log_l1(image, batch.image[0]).mean() for image in decoded[:-1]])
        change = torch.stack([log_l1(a, b).mean() for a, b in pairwise(decoded)])
        traces.append(torch.stack([residual, error, change]).cpu().numpy())
        if index < pictured_scenes:
            images.append(torch.stack(decoded[:-1])[:, 0].permute(0, 2, 3, 1).cpu().numpy())
            references.append(batch.image[0, 0].permute(1, 2, 0).cpu().numpy())
        on_scene()
    residual, error, change = np.stack(traces, axis=-1)
    return TransportTrace(operator.iterations, residual, error, change, np.stack(images, 1), np.stack(references))


def operator_of(network: nn.Module) -> PhysicsInformedTransport:
    """The module that contains a network's operator. Raises UserError if there is none."""
    transport = network.transport.transport if isinstance(network.transport, EncodedTransport) else network.transport
    if not isinstance(transport, PhysicsInformedTransport):
        raise UserError(f"the checkpoint's {type(transport).__name__} applies no operator: give one trained with PITG")
    return transport


def _decoded(
    network: RenderFormerPP, batch: RaggedBatch, applications: int
) -> tuple[list[torch.Tensor], Float[torch.Tensor, " n"]]:
    """Linear radiance [V, 3, H, W] after 0 … n applications, and the n residuals between them."""
    log_radiance, (_, scattered) = network.bounces(batch, applications)
    residual = torch.stack([(a - b).square().mean() for a, b in pairwise(scattered)])
    return [log_decode(image[0].float()).clamp_min(0) for image in log_radiance], residual

"""Radiance losses: L1 between log-encoded images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_encode


def log_l1(
    predicted_log: Float[Tensor, "*images 3 h w"], target_radiance: Float[Tensor, "*images 3 h w"]
) -> Float[Tensor, ""]:
    """Compute mean |log10(1 + x) - log10(1 + y)| (paper, training objective) in float32.

    Args:
        predicted_log: log10(1 + radiance), the output of a network.
        target_radiance: Linear radiance.
    """
    with torch.autocast(predicted_log.device.type, enabled=False):
        return (predicted_log.float() - log_encode(target_radiance.float())).abs().mean()


class ExposedLogL1:
    """Log-L1 of images and, with a weight, of the same images at other exposures.

    In the dark, log10(1 + x) is nearly linear, so a visible halo costs little. At a higher exposure it counts.

    Args:
        exposures: Mean radiance of the exposed references.
        weight: Weight of each exposure; the images themselves have weight 1.
    """

    def __init__(self, exposures: Sequence[float | int], weight: float):
        self.exposures, self.weight = exposures, weight

    def __call__(self, predicted: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]) -> Float[Tensor, ""]:
        """Compute the loss of linear radiance."""
        loss = log_l1(log_encode(predicted), reference)
        mean = reference.mean((1, 2, 3), keepdim=True).clamp_min(1e-6)
        for exposure in self.exposures:
            factor = exposure / mean
            loss = loss + self.weight * log_l1(log_encode(factor * predicted), factor * reference)
        return loss

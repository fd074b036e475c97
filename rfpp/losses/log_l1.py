"""The radiance loss: L1 between log-encoded images."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_encode


def log_l1(
    predicted_log: Float[Tensor, "*images 3 h w"], target_radiance: Float[Tensor, "*images 3 h w"]
) -> Float[Tensor, ""]:
    """mean |log10(1 + x) - log10(1 + y)| (paper, training objective), computed in float32.

    Args:
        predicted_log: the network's output, log10(1 + radiance) already.
        target_radiance: linear radiance.
    """
    with torch.autocast(predicted_log.device.type, enabled=False):
        return (predicted_log.float() - log_encode(target_radiance.float())).abs().mean()

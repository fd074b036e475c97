"""Perceptual loss: LPIPS between tone-mapped images, with gradient to the prediction."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_decode, perceptual
from rfpp.metrics.lpips import LPIPS, load_trunk


class PerceptualLoss:
    """Mean LPIPS of clamp(log2(1 + I), 0, 1) scaled to [-1, 1] (paper, training objective).

    Not an `nn.Module`, so that the trunk is neither trained nor saved with the model; see `LPIPS`.

    Args:
        images_per_step: Number of images of a batch that are read, at full resolution; None reads all. A step with
            several batches (devices, gradient accumulation) reads as many of each.

    Raises:
        MissingDependencyError: If the weights are not in the user cache.
    """

    def __init__(self, images_per_step: int | None = None) -> None:
        if images_per_step is not None and images_per_step < 1:
            raise ValueError(f"images_per_step must be at least 1, got {images_per_step}; a weight of 0 omits LPIPS")
        self.images_per_step = images_per_step
        self._lpips = LPIPS(load_trunk())

    def __call__(
        self, predicted_log: Float[Tensor, "*images 3 h w"], target_radiance: Float[Tensor, "*images 3 h w"]
    ) -> Float[Tensor, ""]:
        """Compute the unweighted loss of log10(1 + radiance) against linear radiance, in float32."""
        prediction = predicted_log.flatten(0, -4)[: self.images_per_step]  # [n, 3, h, w]
        target = target_radiance.flatten(0, -4)[: self.images_per_step]
        with torch.autocast(prediction.device.type, enabled=False):
            return self._lpips(
                2 * perceptual(log_decode(prediction.float())) - 1, 2 * perceptual(target.float()) - 1
            ).mean()

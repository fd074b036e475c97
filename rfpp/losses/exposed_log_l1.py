"""The radiance loss of images that are looked at under more than one exposure."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_encode
from rfpp.losses.log_l1 import log_l1


class ExposedLogL1:
    """log-L1, and a share of the log-L1 of the same images with several times their light.

    log10(1 + x) is hardly less than x in the dark: a halo there is no error, though it is seen, and HDR-ꟻLIP looks for
    it. Exposed so that the mean of an image is well above 1, it is one.

    Args:
        exposures: means of the exposed references.
        weight: of each exposure; that of the image as it is is 1.
    """

    def __init__(self, exposures: Sequence[float | int], weight: float):
        self.exposures, self.weight = exposures, weight

    def __call__(self, predicted: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]) -> Float[Tensor, ""]:
        """Of linear radiance."""
        loss = log_l1(log_encode(predicted), reference)
        mean = reference.mean((1, 2, 3), keepdim=True).clamp_min(1e-6)
        for exposure in self.exposures:
            factor = exposure / mean
            loss = loss + self.weight * log_l1(log_encode(factor * predicted), factor * reference)
        return loss

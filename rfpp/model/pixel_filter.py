"""From radiance at the pixels' centres to pixels."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


class CentreSample:
    """A pixel is what its centre sees (the paper's)."""

    def __call__(self, radiance: Float[Tensor, "n 3 h w"], points: int = 1) -> Float[Tensor, "n 3 h w"]:
        return radiance


class PixelFilter:
    """A pixel takes part in its neighbours, as it does in a path-traced image, whose edges are smooth.

    Not in the paper. G-buffers are sampled at pixel centres, and what multiplies them keeps their jagged edges.

    Args:
        share: of each neighbour along a row and along a column; the pixel itself keeps 1 - 2 share of either.
            Pixels of several points already are means over their area, and take less in proportion.
    """

    def __init__(self, share: float):
        self.share = share

    def __call__(self, radiance: Float[Tensor, "n 3 h w"], points: int = 1) -> Float[Tensor, "n 3 h w"]:
        share = self.share / points
        x = F.pad(radiance, (1, 1, 1, 1), mode="replicate")
        # sums, not a convolution, which mixed precision would round to eight bits
        x = share * (x[..., :-2, :] + x[..., 2:, :]) + (1 - 2 * share) * x[..., 1:-1, :]
        return share * (x[..., :-2] + x[..., 2:]) + (1 - 2 * share) * x[..., 1:-1]

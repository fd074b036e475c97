"""The transport consistency loss (paper, Sec. 3.1): scattered light should not change when transported again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.segments import Segments


class TransportConsistency(nn.Module):
    """Residuals ‖⁽ᵏ⁾F_s − T(⁽ᵏ⁾F_s + F_e)‖² for k = 1 … K, each a mean square over tokens and channels, in fp32.

    The operator's output at k is the next state, so K + 1 consecutive states hold everything. Every scene has the same
    weight, whatever its number of tokens: how a global batch is divided among devices then makes no difference.

    Args:
        stop_gradient: hold the updated state fixed, so that only the current one is pulled.
    """

    def __init__(self, stop_gradient: bool = False):
        super().__init__()
        self.stop_gradient = stop_gradient

    def forward(
        self, states: Sequence[Float[Tensor, "n width"]], scenes: Segments | None = None, count: int | None = None
    ) -> Float[Tensor, " k"]:
        """Return the residuals [K]; the loss is their sum.

        Args:
            states: K + 1 scattered features, or none (then K = 0).
            scenes: segments of the N tokens; None: they are all of one scene.
            count: the scenes that count, the first ones; None: all of them. Padding comes after them.
        """
        residuals = []
        for current, updated in pairwise(states):
            target = updated.detach() if self.stop_gradient else updated
            square = (current.float() - target.float()).square().mean(-1)  # [N]
            residuals.append(square.mean() if scenes is None else square @ _weights(scenes, count))
        return torch.stack(residuals) if residuals else torch.zeros(0)


def _weights(scenes: Segments, count: int | None) -> Float[Tensor, " n"]:
    """Return weights [N] that sum to 1, with equal sums for each of the first `count` scenes."""
    weight = 1 / ((count or len(scenes)) * scenes.sizes.clamp_min(1).float())
    if count is not None and count < len(scenes):
        weight = weight * (torch.arange(len(scenes), device=weight.device) < count)
    return weight[scenes.index]

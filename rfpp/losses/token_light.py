"""Tokens supervised by light: after each iteration, a token holds the light of the surfaces it stands for."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.imaging.radiance import log_encode


class TokenLight(nn.Module):
    """Mean `|W ⁽ᵏ⁾F_s + b − log10(1 + E_k / π)|` over k = 1 … K, tokens and colors. Ours, not the paper's.

    Query q of an object stands for its surfaces that face octant q, and E_k is their mean irradiance after k bounces.
    The linear decoder is trained with the network and not part of it.

    Args:
        width: Token width D.
    """

    def __init__(self, width: int):
        super().__init__()
        self.decode = nn.Linear(width, 3)

    def forward(
        self, states: Sequence[Float[Tensor, "n width"]], token_light: Float[Tensor, "n k 3"]
    ) -> Float[Tensor, ""]:
        """Compute the loss.

        Args:
            states: Scattered features after k = 1, 2, …
            token_light: E_k / π for k = 0, 1, …; NaN where a token stands for no surface.
        """
        count = min(len(states), token_light.shape[1] - 1)
        found = torch.stack([self.decode(state.float()) for state in states[:count]], dim=1)  # [N, K, 3]
        target = token_light[:, 1 : count + 1]
        known = target.isfinite()
        difference = (found - log_encode(target.where(known, 0.0))).abs() * known
        return difference.sum() / known.sum().clamp_min(1)

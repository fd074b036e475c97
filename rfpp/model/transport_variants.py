"""What the operator of PITG is tried without: rows to find out what makes it matter. None of these is in the paper."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.attention import AttentionPattern
from rfpp.model.encoding import Rotation
from rfpp.model.tokenizer import SceneTokens
from rfpp.model.transport import PhysicsInformedTransport, Transported, TransportOperator


class UnscaledOperator(TransportOperator):
    """T without unit RMS: how much light a token has may show in the length of its features."""

    def __init__(self, width: int, heads: int, hidden: int, layers: int):
        super().__init__(width, heads, hidden, layers)
        self.norm = nn.Identity()


class DifferenceOperator(TransportOperator):
    """T without the residual identity: of x + δ, what its blocks make of x, it hands on δ alone."""

    def forward(
        self, features: Float[Tensor, "n width"], pattern: AttentionPattern, rotation: Rotation
    ) -> Float[Tensor, "n width"]:
        moved = features
        for block in self.blocks:
            moved = block(moved, pattern, rotation)
        difference: Tensor = self.norm(moved - features)
        return difference


class UnscaledTransport(PhysicsInformedTransport):
    """PITG with UnscaledOperator."""

    operator_class = UnscaledOperator


class DifferenceTransport(PhysicsInformedTransport):
    """PITG with DifferenceOperator."""

    operator_class = DifferenceOperator


class NoTokens(nn.Module):
    """Hands on zeros: what a network comes to that has to do without its scene tokens from the first step on."""

    iterations = 0

    def forward(self, tokens: SceneTokens) -> Transported:
        return Transported(replace(tokens, features=torch.zeros_like(tokens.features)))

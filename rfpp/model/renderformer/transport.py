"""RenderFormer's light transport: self-attention between all tokens, without the structure of PITG."""

from __future__ import annotations

from dataclasses import replace

from torch import nn

from rfpp.model.layers.attention import AttentionPattern
from rfpp.model.layers.block import SelfBlock
from rfpp.model.layers.encoding import RelativeSpatialEncoding
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.pitg import PhysicsInformedTransport, Transported, TransportStates
from rfpp.ranges import Positive


class UnconstrainedTransport(nn.Module):
    """Self-attention between all tokens of a scene.

    Args:
        width: Token width D.
        layers: Self-attention blocks.
        frequencies: RSPE frequencies.
    """

    iterations = 0

    def __init__(self, width: Positive, heads: Positive, hidden: Positive, layers: Positive, frequencies: Positive):
        super().__init__()
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.blocks = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(layers))

    def forward(self, tokens: SceneTokens) -> Transported:
        features, pattern, rotation = tokens.features, AttentionPattern(tokens.segments), self.position(tokens.points)
        for block in self.blocks:
            features = block(features, pattern, rotation)
        return Transported(replace(tokens, features=features))


class EncodedTransport(nn.Module):
    """Self-attention between all tokens, then PITG: RenderFormer w/ PITG (paper, Table 2).

    Args:
        encoder: Self-attention that stands in for the object encoder.
        transport: Operator, applied K times.
    """

    def __init__(self, encoder: UnconstrainedTransport, transport: PhysicsInformedTransport):
        super().__init__()
        self.encoder, self.transport = encoder, transport

    def forward(self, tokens: SceneTokens) -> Transported:
        transported: Transported = self.transport(self.encoder(tokens).tokens)
        return transported

    @property
    def iterations(self) -> int:
        """K, the applications of the operator."""
        return self.transport.iterations

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """Return the tokens after k = 0 … `count` applications; see `PhysicsInformedTransport.each`."""
        return self.transport.each(self.encoder(tokens).tokens, count)

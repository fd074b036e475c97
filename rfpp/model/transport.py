"""Light transport between scene tokens: unconstrained (RenderFormer) or shaped like the rendering equation (PITG)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.attention import AttentionPattern
from rfpp.model.block import NORM_EPS, SelfBlock
from rfpp.model.encoding import RelativeSpatialEncoding, Rotation
from rfpp.model.tokenizer import SceneTokens


@dataclass(frozen=True)
class Transported:
    """What a transport stage hands on.

    Attributes:
        tokens: the scene tokens with global illumination in their features.
        states: the scattered features ⁽ᵏ⁾F_s, k = 1 … K, and in training one more: T(⁽ᴷ⁾F_s + F_e). Each [N, D].
            Empty where there is no operator.
        divergence: of couplings between cells from what rays see, in training; see `rfpp.model.form_factors`.
    """

    tokens: SceneTokens
    states: tuple[Float[Tensor, "n width"], ...] = ()
    divergence: Float[Tensor, ""] | None = None


class TransportStates(NamedTuple):
    """F_e [N, D] and the scattered features ⁽⁰⁾F_s, ⁽¹⁾F_s, …, one more than the applications of the operator.

    Or what stands for them: light between cells.
    """

    emitted: Float[Tensor, "n width"]
    scattered: tuple[Float[Tensor, "n width"], ...]


@runtime_checkable
class Transport(Protocol):
    """From scene tokens to scene tokens that know of global illumination.

    Attributes:
        iterations: how often the operator is applied; 0 where there is none.
    """

    iterations: int

    def __call__(self, tokens: SceneTokens) -> Transported: ...


@runtime_checkable
class IteratedTransport(Transport, Protocol):
    """One with an operator, which can be applied any number of times."""

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """The tokens after k = 0 … `count` applications; see `PhysicsInformedTransport`."""


class UnconstrainedTransport(nn.Module):
    """Self-attention between all tokens of a scene, as in RenderFormer."""

    iterations = 0

    def __init__(self, width: int, heads: int, hidden: int, layers: int, frequencies: int):
        super().__init__()
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.blocks = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(layers))

    def forward(self, tokens: SceneTokens) -> Transported:
        features, pattern, rotation = tokens.features, AttentionPattern(tokens.segments), self.position(tokens.points)
        for block in self.blocks:
            features = block(features, pattern, rotation)
        return Transported(replace(tokens, features=features))


class EncodedTransport(nn.Module):
    """Self-attention between all tokens first, then the operator: PITG where no tokenizer has encoded them before.

    RenderFormer w/ PITG (paper, Table 2).
    """

    def __init__(self, encoder: UnconstrainedTransport, transport: PhysicsInformedTransport):
        super().__init__()
        self.encoder, self.transport = encoder, transport

    def forward(self, tokens: SceneTokens) -> Transported:
        transported: Transported = self.transport(self.encoder(tokens).tokens)
        return transported

    @property
    def iterations(self) -> int:
        return self.transport.iterations

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        return self.transport.each(self.encoder(tokens).tokens, count)


class EmissionEncoder(nn.Module):
    """EEncode (paper, Sec. 3.1): one MLP gives F_e from tokens and emission, F_s from tokens and zeros.

    Both have root mean square 1 in every token, see TransportOperator.
    """

    def __init__(self, width: int):
        super().__init__()
        self.emission_proj = nn.Linear(3, width, bias=False)  # no bias: no emission, exactly zero
        self.mlp = nn.Sequential(
            nn.Linear(2 * width, width, bias=False), nn.SiLU(), nn.Linear(width, width, bias=False), UnitRMS()
        )

    def forward(
        self, features: Float[Tensor, "n width"], log_light: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n width"], Float[Tensor, "n width"]]:
        """(F_e, F_s)."""
        emission = self.emission_proj(log_light)
        emitted = self.mlp(torch.cat([features, emission.to(features.dtype)], dim=-1))
        scattered = self.mlp(torch.cat([features, torch.zeros_like(features)], dim=-1))
        return emitted, scattered


class UnitRMS(nn.Module):
    """x / √(mean x²) of each token: an RMS norm without a weight that training could shrink."""

    def forward(self, x: Float[Tensor, "n width"]) -> Float[Tensor, "n width"]:
        return F.rms_norm(x.float(), x.shape[-1:], eps=NORM_EPS)


class TransportOperator(nn.Module):
    """T: moves light once between the tokens of each scene.

    The transported features have root mean square 1. Where the paper is silent this is our choice: the consistency
    loss could otherwise be lowered by shrinking all features.
    """

    def __init__(self, width: int, heads: int, hidden: int, layers: int):
        super().__init__()
        self.blocks = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(layers))
        self.norm: nn.Module = UnitRMS()

    def forward(
        self, features: Float[Tensor, "n width"], pattern: AttentionPattern, rotation: Rotation
    ) -> Float[Tensor, "n width"]:
        for block in self.blocks:
            features = block(features, pattern, rotation)
        moved: Tensor = self.norm(features)
        return moved


class PhysicsInformedTransport(nn.Module):
    """PITG (paper, Sec. 3.1): ⁽ᵏ⁺¹⁾F_s = T(⁽ᵏ⁾F_s + F_e), K times with one shared operator, then F_s + F_e."""

    operator_class: type[TransportOperator] = TransportOperator

    def __init__(self, width: int, heads: int, hidden: int, layers: int, iterations: int, frequencies: int):
        super().__init__()
        self.iterations = iterations
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.emission_encoder = EmissionEncoder(width)
        self.operator = self.operator_class(width, heads, hidden, layers)

    def forward(self, tokens: SceneTokens) -> Transported:
        # in training one more application, for the consistency loss of the last state
        after, (_, states) = self.each(tokens, self.iterations + self.training)
        return Transported(after[self.iterations], states[1:])

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """The tokens with ⁽ᵏ⁾F_s + F_e for features, k = 0 … `count`, whatever K; and these."""
        pattern, rotation = AttentionPattern(tokens.segments), self.position(tokens.points)
        emitted, scattered = self.emission_encoder(tokens.features, tokens.log_light)
        states = [scattered]
        for _ in range(count):
            states.append(self.operator(states[-1] + emitted, pattern, rotation))
        after = [replace(tokens, features=state + emitted) for state in states]
        return after, TransportStates(emitted, tuple(states))

"""Physics-Informed Transport Guidance (paper, Sec. 3.1): light moves between tokens as in the rendering equation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.layers.attention import AttentionPattern
from rfpp.model.layers.block import NORM_EPS, SelfBlock
from rfpp.model.layers.encoding import RelativeSpatialEncoding, Rotation
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.ranges import NonNegative, Positive


@dataclass(frozen=True)
class Transported:
    """Result of a transport stage.

    Attributes:
        tokens: Scene tokens with global illumination in their features.
        states: Scattered features ⁽ᵏ⁾F_s for k = 1 … K, each [N, D]; in training one more, T(⁽ᴷ⁾F_s + F_e).
            Empty if the stage has no operator.
    """

    tokens: SceneTokens
    states: tuple[Float[Tensor, "n width"], ...] = ()


class TransportStates(NamedTuple):
    """F_e [N, D] and the scattered features ⁽⁰⁾F_s, ⁽¹⁾F_s, …, one more than applications of the operator."""

    emitted: Float[Tensor, "n width"]
    scattered: tuple[Float[Tensor, "n width"], ...]


@runtime_checkable
class Transport(Protocol):
    """Stage from scene tokens to scene tokens that hold global illumination.

    Attributes:
        iterations: Applications of the operator; 0 if there is none.
    """

    iterations: int

    def __call__(self, tokens: SceneTokens) -> Transported: ...


@runtime_checkable
class IteratedTransport(Transport, Protocol):
    """Transport with an operator, which can be applied any number of times."""

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """Return the tokens after k = 0 … `count` applications; see `PhysicsInformedTransport.each`."""


class PhysicsInformedTransport(nn.Module):
    """⁽ᵏ⁺¹⁾F_s = T(⁽ᵏ⁾F_s + F_e), K times with one shared operator, then F̃ = ⁽ᴷ⁾F_s + F_e.

    Args:
        width: Token width D.
        layers: Self-attention blocks of the operator T.
        iterations: K; 0 leaves the operator out.
        frequencies: RSPE frequencies.
    """

    def __init__(
        self,
        width: Positive,
        heads: Positive,
        hidden: Positive,
        layers: Positive,
        iterations: NonNegative,
        frequencies: Positive,
    ):
        super().__init__()
        self.iterations = iterations
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.emission_encoder = EmissionEncoder(width)
        self.operator = TransportOperator(width, heads, hidden, layers)

    def forward(self, tokens: SceneTokens) -> Transported:
        # in training one more application, for the consistency loss of the last state
        after, (_, states) = self.each(tokens, self.iterations + (self.training and self.iterations > 0))
        return Transported(after[self.iterations], states[1:])

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """Return the tokens with features ⁽ᵏ⁾F_s + F_e for k = 0 … `count`, and F_e with all ⁽ᵏ⁾F_s."""
        pattern, rotation = AttentionPattern(tokens.segments), self.position(tokens.points)
        emitted, scattered = self.emission_encoder(tokens.features, tokens.log_emission)
        states = [scattered]
        for _ in range(count):
            states.append(self.operator(states[-1] + emitted, pattern, rotation))
        after = [replace(tokens, features=state + emitted) for state in states]
        return after, TransportStates(emitted, tuple(states))


class EmissionEncoder(nn.Module):
    """EEncode: one MLP gives F_e from tokens and emission, and F_s from tokens and zeros.

    Both have unit root mean square in every token; see `TransportOperator`.
    """

    def __init__(self, width: int):
        super().__init__()
        self.emission_proj = nn.Linear(3, width, bias=False)  # no bias: no emission, exactly zero
        self.mlp = nn.Sequential(
            nn.Linear(2 * width, width, bias=False), nn.SiLU(), nn.Linear(width, width, bias=False), UnitRMS()
        )

    def forward(
        self, features: Float[Tensor, "n width"], log_emission: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n width"], Float[Tensor, "n width"]]:
        """Return (F_e, F_s)."""
        emission = self.emission_proj(log_emission)
        emitted = self.mlp(torch.cat([features, emission.to(features.dtype)], dim=-1))
        scattered = self.mlp(torch.cat([features, torch.zeros_like(features)], dim=-1))
        return emitted, scattered


class TransportOperator(nn.Module):
    """T: moves light once between the tokens of each scene.

    Its output has unit root mean square. The paper does not say so; without it the consistency loss could be lowered by
    shrinking all features.
    """

    def __init__(self, width: int, heads: int, hidden: int, layers: int):
        super().__init__()
        self.blocks = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(layers))
        self.norm = UnitRMS()

    def forward(
        self, features: Float[Tensor, "n width"], pattern: AttentionPattern, rotation: Rotation
    ) -> Float[Tensor, "n width"]:
        for block in self.blocks:
            features = block(features, pattern, rotation)
        moved: Tensor = self.norm(features)
        return moved


class UnitRMS(nn.Module):
    """x / √(mean x²) of each token: an RMS norm without a weight that training could shrink."""

    def forward(self, x: Float[Tensor, "n width"]) -> Float[Tensor, "n width"]:
        return F.rms_norm(x.float(), x.shape[-1:], eps=NORM_EPS)

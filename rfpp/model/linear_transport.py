"""Light transport that is linear in light: weights know geometry and materials, light passes through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.autocast import in_float32
from rfpp.model.block import NORM_EPS, RMSNorm, SwiGLU
from rfpp.model.bounces import DullBounce, light_after
from rfpp.model.couplings import Corrections, Couplings
from rfpp.model.form_factors import CastFormFactors, UnoccludedFormFactors
from rfpp.model.irradiance import CastIrradiance, CoupledIrradiance
from rfpp.model.lit_cells import LitCells, Reflectance
from rfpp.model.tokenizer import SceneTokens
from rfpp.model.transport import Transported, TransportStates, UnconstrainedTransport
from rfpp.packed_cells import PackedCells
from rfpp.segments import on_device

#: What of lit cells differs from bounce to bounce.
_LIGHT = ("arriving", "before")
#: A surface sends on at most so much of what arrives: with row sums of A of at most 1, energy never grows.
HIGHEST_ALBEDO = 0.98


class LinearTransport(nn.Module):
    """I⁽ᵏ⁺¹⁾ = E + A ρ I⁽ᵏ⁾ + B ρ I⁽ᵏ⁻¹⁾ between the cells of a scene, K times: I is light that arrives.

    Not in the paper, whose operator T moves features; here it is a matrix. The scene tokens look at each other first.
    A is the softmax, over the cells of a scene and what escapes, of log(form factor) plus a correction that is learned
    from tokens and bounded: an unbounded one closes early in training, and stays closed. B is light that comes by way
    of a glossy lobe, one bounce more (`GlossyBounce`). What leaves from there leaves as if all were dull.

    Args:
        encoder: between scene tokens.
        width, hidden: of tokens, of the cells' SwiGLU.
        rank: of the corrections.
        bound: γ; corrections multiply by e^±γ at most.
        iterations: K.
        form_factors: CastFormFactors or UnoccludedFormFactors.
        irradiance: CastIrradiance or CoupledIrradiance, which E is.
    """

    def __init__(
        self,
        encoder: UnconstrainedTransport,
        width: int,
        hidden: int,
        rank: int,
        bound: float,
        iterations: int,
        form_factors: CastFormFactors | UnoccludedFormFactors,
        irradiance: CastIrradiance | CoupledIrradiance,
    ):
        super().__init__()
        self.encoder, self.cell_features = encoder, CellFeatures(width, hidden)
        self.corrections = nn.Linear(width, 2 * rank + 1, bias=False)
        nn.init.zeros_(self.corrections.weight[rank:])  # starts as the form factors are
        self.rank, self.bound, self.iterations = rank, bound, iterations
        self.form_factors, self.irradiance = form_factors, irradiance

    def forward(self, tokens: SceneTokens) -> Transported:
        lit, states, couplings = self._each(tokens, self.iterations + self.training)
        divergence_from_rays = couplings.divergence() if self.training else None
        return Transported(self._as_far_as_the_images(lit, tokens.bounces), states[1:], divergence_from_rays)

    def _as_far_as_the_images(self, lit: list[SceneTokens], bounces: tuple[int | None, ...]) -> SceneTokens:
        """⁽ᴷ⁾I of each scene; where its images end after n bounces, ⁽ⁿ⁻¹⁾I: the last is from cells to pixels."""
        counts = [self.iterations if n is None else min(self.iterations, max(n - 1, 0)) for n in bounces]
        if all(count == self.iterations for count in counts):
            return lit[self.iterations]
        cells = lit[0].lit_cells
        taken = on_device(np.repeat(counts, cells.cells.scenes.lengths), cells.first.device)
        row = torch.arange(len(taken), device=taken.device)
        now, before = (torch.stack([getattr(one.lit_cells, name) for one in lit])[taken, row] for name in _LIGHT)
        return replace(lit[0], cells=replace(cells, arriving=now, before=before))

    def each(self, tokens: SceneTokens, count: int) -> tuple[list[SceneTokens], TransportStates]:
        """The tokens with ⁽ᵏ⁾I on their cells, k = 0 … `count`, and these."""
        lit, states, _ = self._each(tokens, count)
        return lit, TransportStates(torch.zeros_like(states[0]), states)

    def _each(
        self, tokens: SceneTokens, count: int
    ) -> tuple[list[SceneTokens], tuple[Float[Tensor, "c 3"], ...], Couplings]:
        tokens, cells = told_apart(self.encoder(told_apart(tokens)).tokens), tokens.unlit_cells
        features = self.cell_features(tokens, cells)
        with in_float32(features):
            bounce = self._operator(features.float(), cells)
            first = self.irradiance(cells, bounce.couplings)
            states = light_after(first, bounce, count)
        before = (torch.zeros_like(first), *states)
        lit = [
            replace(tokens, cells=LitCells(cells, features, bounce.reflectance, first, now, earlier))
            for now, earlier in zip(states, before, strict=False)
        ]
        return lit, states, bounce.couplings

    def _operator(self, features: Float[Tensor, "c width"], cells: PackedCells) -> DullBounce:
        """What A and ρ do to light."""
        projected = F.linear(features, self.corrections.weight.float())
        query, key, escape = projected.split([self.rank, self.rank, 1], dim=-1)
        learned = Corrections(query, key, escape[:, 0], self.bound)
        reflectance = Reflectance(cells.diffuse, cells.specular).bounded(HIGHEST_ALBEDO)
        return self.form_factors.bounce(cells, reflectance, learned)


def told_apart(tokens: SceneTokens) -> SceneTokens:
    """Features without their mean over the scene, and with root mean square 1 there.

    What all tokens share says nothing of any. Training lets it grow all the same, until next to it what tells tokens
    apart is lost (1% of their length after 1,000 steps, and nothing was read any more).
    """
    x, segments = tokens.features.float(), tokens.segments
    sums = x.new_zeros(len(segments), x.shape[1]).index_add(0, segments.index, x)
    x = x - (sums / segments.sizes[:, None])[segments.index]
    power = x.new_zeros(len(segments)).index_add(0, segments.index, x.square().mean(-1)) / segments.sizes
    return replace(tokens, features=x * (power + NORM_EPS).rsqrt()[segments.index, None])


class CellFeatures(nn.Module):
    """What is known of a cell: its token, where in its object it lies and faces, and what it is made of."""

    #: Distances within objects are in these units, world units.
    REACH = 0.2

    def __init__(self, width: int, hidden: int):
        super().__init__()
        self.place = nn.Linear(14, width)
        self.norm, self.feed_forward, self.out_norm = RMSNorm(width), SwiGLU(width, hidden), RMSNorm(width)

    def forward(self, tokens: SceneTokens, cells: PackedCells) -> Float[Tensor, "c width"]:
        size = cells.area.clamp_min(1e-8).sqrt().log()[:, None]
        within = cells.centre - tokens.points[cells.octant, 3:6]  # from the object's centroid
        material = [cells.diffuse, cells.specular, cells.roughness[:, None]]
        place = self.place(torch.cat([within / self.REACH, cells.normal, size, *material], dim=-1))
        x = tokens.features[cells.octant] + place
        features: Tensor = self.out_norm(x + self.feed_forward(self.norm(x)))
        return features

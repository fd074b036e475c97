"""Random materials."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rfpp.ranges import Share
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform
from rfpp.scene.spec import Material


@dataclass(frozen=True)
class MaterialSampler(HasIntervals):
    """RenderFormer's material distribution, one material per object; all quantities are independent.

    Attributes:
        reflectance: diffuse plus specular albedo, before the diffuse part is multiplied by its color.
        specular_share: white specular share of the reflectance; the rest is diffuse.
        diffuse_color: factor of the diffuse part, drawn per channel.
        roughness: log-uniform in roughness + `roughness_shift`, so that mirrors are common but not the rule.
    """

    reflectance: Interval
    specular_share: Interval
    diffuse_color: Interval
    roughness: Interval
    roughness_shift: Share
    smooth_shading: Share

    def sample(self, rng: np.random.Generator) -> Material:
        """Draw a non-emissive material that conserves energy."""
        reflectance = uniform(rng, self.reflectance)
        specular = uniform(rng, self.specular_share) * reflectance
        diffuse = (reflectance - specular) * uniform(rng, self.diffuse_color, 3)
        low, high = (math.log(limit + self.roughness_shift) for limit in self.roughness)
        # exp and log may not cancel exactly at the ends
        roughness = float(np.clip(math.exp(rng.uniform(low, high)) - self.roughness_shift, *self.roughness))
        return Material(
            diffuse=tuple(diffuse.tolist()),
            specular=(specular,) * 3,
            roughness=roughness,
            smooth_shading=bool(rng.random() < self.smooth_shading),
        )

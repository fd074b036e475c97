"""Object sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rfpp.ranges import NonNegativeFloat, PositiveFloat
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform


@runtime_checkable
class SizeSampler(Protocol):
    """Sampler of the bounding-sphere radii of a scene's objects before placement."""

    def sample(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, " count"]: ...


@dataclass(frozen=True)
class SharedSpace(HasIntervals):
    """Log-normal radii around a base radius that decreases with the number of objects.

    Attributes:
        fill: share φ of the unit cube filled by N spheres of the base radius (3φ / 4πN)^(1/3).
        spread: standard deviation of the logarithm of a radius.
        max_radius: upper bound, so that no object hides the whole scene.
    """

    fill: Interval
    spread: NonNegativeFloat
    max_radius: PositiveFloat

    def sample(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, " count"]:
        base_radius = (3 * uniform(rng, self.fill) / (4 * np.pi * count)) ** (1 / 3)
        return np.minimum(base_radius * np.exp(rng.normal(0.0, self.spread, count)), self.max_radius)


@dataclass(frozen=True)
class UniformRadius(HasIntervals):
    """Uniform radii, independent of the number of objects."""

    radius: Interval

    def sample(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, " count"]:
        return uniform(rng, self.radius, count)

"""Means over scenes with bootstrap confidence intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.evaluation.measuring.records import SceneRecord

#: Percentiles that enclose 95% of the resampled means.
INTERVAL = (2.5, 97.5)


@dataclass(frozen=True)
class Estimate:
    """A mean over scenes with its 95% confidence interval.

    Attributes:
        low: Lower end of the interval; NaN for a single scene.
    """

    mean: float
    low: float
    high: float
    scenes: int

    @property
    def margin(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2


#: Estimates by metric name.
Estimates = Mapping[str, Estimate]


@dataclass(frozen=True)
class Bootstrap:
    """Percentile bootstrap over scenes (Efron 1979)."""

    resamples: int
    seed: int

    def __call__(self, values: Float[np.ndarray, "scenes metrics"]) -> list[Estimate]:
        """Estimate the mean of each column."""
        scenes = len(values)
        if scenes == 1:
            return [Estimate(float(value), np.nan, np.nan, 1) for value in values[0]]
        draws = np.random.default_rng(self.seed).integers(scenes, size=(self.resamples, scenes))
        return [self._estimate(column, draws) for column in values.T]

    def _estimate(self, column: np.ndarray, draws: np.ndarray) -> Estimate:
        # this method returns one of the means: interpolating between two infinite ones would give NaN
        low, high = np.percentile(column[draws].mean(axis=1), INTERVAL, method="inverted_cdf")
        return Estimate(float(column.mean()), float(low), float(high), len(column))


def split_estimates(records: Iterable[SceneRecord], bootstrap: Bootstrap) -> dict[tuple[str, str], Estimates]:
    """Return estimates by (split, predictor), with equal weight for each scene."""
    grouped = defaultdict(list)
    for record in records:
        grouped[record.split, record.predictor].append(record.values)
    means = {}
    for key, group in grouped.items():
        columns = bootstrap(np.array([[values[name] for name in group[0]] for values in group]))
        means[key] = dict(zip(group[0], columns, strict=True))
    return means


def mean_of_parts(parts: Sequence[Estimate]) -> Estimate:
    """Return the mean of estimates from different scenes, such as two splits, with equal weights.

    Their errors are independent, so the distances to the interval's ends add in quadrature.
    """
    mean = np.mean([part.mean for part in parts])
    below = np.linalg.norm([part.mean - part.low for part in parts]) / len(parts)
    above = np.linalg.norm([part.high - part.mean for part in parts]) / len(parts)
    return Estimate(float(mean), float(mean - below), float(mean + above), sum(part.scenes for part in parts))


def mean_of_seeds(seeds: Sequence[Estimate]) -> Estimate:
    """Return the mean of estimates from the same scenes. Their errors are correlated, so interval ends are averaged."""
    mean, low, high = np.mean([(seed.mean, seed.low, seed.high) for seed in seeds], axis=0).tolist()
    return Estimate(mean, low, high, seeds[0].scenes)

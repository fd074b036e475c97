"""Means over scenes with bootstrap confidence intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.evaluation.measuring.records import SceneRecord

#: Percentiles between which 95% of the resampled means lie.
INTERVAL = (2.5, 97.5)


@dataclass(frozen=True)
class Estimate:
    """A mean over scenes with its 95% confidence interval.

    Attributes:
        mean: NaN where a scene's value is.
        low, high: ends of the interval; NaN for a single scene, which says nothing of others.
        scenes: number of scenes behind it.
    """

    mean: float
    low: float
    high: float
    scenes: int

    @property
    def margin(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2


#: By metric name.
Estimates = Mapping[str, Estimate]


@dataclass(frozen=True)
class Bootstrap:
    """The percentile bootstrap over scenes (Efron 1979): the same scenes drawn again, with replacement.

    A pure function of its input: equal numbers of scenes are resampled alike, whatever was asked before.

    Attributes:
        resamples: number of draws.
        seed: of the draws.
    """

    resamples: int
    seed: int

    def __call__(self, values: Float[np.ndarray, "scenes metrics"]) -> list[Estimate]:
        """The estimate of each column."""
        scenes = len(values)
        if scenes == 1:
            return [Estimate(float(value), np.nan, np.nan, 1) for value in values[0]]
        draws = np.random.default_rng(self.seed).integers(scenes, size=(self.resamples, scenes))
        return [self._estimate(column, draws) for column in values.T]

    def _estimate(self, column: np.ndarray, draws: np.ndarray) -> Estimate:
        # percentiles that are one of the means: between two infinite ones there is nothing to interpolate
        low, high = np.percentile(column[draws].mean(axis=1), INTERVAL, method="inverted_cdf")
        return Estimate(float(column.mean()), float(low), float(high), len(column))


def estimates(records: Sequence[SceneRecord], bootstrap: Bootstrap) -> dict[str, Estimate]:
    """Estimates of one predictor's records, by metric."""
    names = list(records[0].values)
    values = np.array([[record.values[name] for name in names] for record in records])
    return dict(zip(names, bootstrap(values), strict=True))


def split_estimates(records: Iterable[SceneRecord], bootstrap: Bootstrap) -> dict[tuple[str, str], Estimates]:
    """Estimates by (split, predictor), with equal weight for each scene."""
    grouped = defaultdict(list)
    for record in records:
        grouped[record.split, record.predictor].append(record)
    return {key: estimates(group, bootstrap) for key, group in grouped.items()}


def mean_of_parts(parts: Sequence[Estimate]) -> Estimate:
    """Mean of estimates from different scenes, such as two splits, with equal weights.

    Their errors are independent: the distances to the interval's ends add in quadrature.
    """
    mean = np.mean([part.mean for part in parts])
    below = np.linalg.norm([part.mean - part.low for part in parts]) / len(parts)
    above = np.linalg.norm([part.high - part.mean for part in parts]) / len(parts)
    return Estimate(float(mean), float(mean - below), float(mean + above), sum(part.scenes for part in parts))


def mean_of_seeds(seeds: Sequence[Estimate]) -> Estimate:
    """Mean of estimates from the same scenes: their errors are correlated, so interval ends are averaged, too."""
    mean, low, high = np.mean([(seed.mean, seed.low, seed.high) for seed in seeds], axis=0).tolist()
    return Estimate(mean, low, high, seeds[0].scenes)

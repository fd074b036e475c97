"""Rank scenes by error and choose which ones to picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rfpp.evaluation.measuring.number_text import number_text
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.metrics.image import METRICS

#: The metric that ranks scenes; lower is better.
RANKED_BY = "log_l1"


def ranking(scenes: Sequence[SceneRecord]) -> list[int]:
    """Indices of one predictor's scenes from the best to the worst; a NaN is worse than any number."""
    errors = [scene.values[RANKED_BY] for scene in scenes]
    return sorted(range(len(errors)), key=lambda index: (math.isnan(errors[index]), errors[index]))


def places(scenes: int) -> dict[str, int]:
    """Names and 0-based ranks of the best, the median and the worst of `count` scenes."""
    return {"best": 0, "median": scenes // 2, "worst": scenes - 1}


def ranked_scenes(scenes: Sequence[SceneRecord]) -> dict[str, int]:
    """The model's best, median and worst scene of one split: caption, with its mean error → index in the split.

    Args:
        scenes: the model's on one whole split, in its order.
    """
    order, label = ranking(scenes), METRICS[RANKED_BY].label
    chosen = {place: order[rank] for place, rank in places(len(scenes)).items()}
    errors = {index: number_text(RANKED_BY, scenes[index].values[RANKED_BY]) for index in chosen.values()}
    return {f"{place}: {scenes[index].scene}, {label} {errors[index]}": index for place, index in chosen.items()}


def pictured_scenes(scenes: Sequence[SceneRecord], count: int) -> list[int]:
    """Indices of at most `count` scenes of one split, three or more: best, median, worst, ranks evenly between them."""
    best, median, worst = places(len(scenes)).values()
    half = (count + 1) // 2
    ranks = np.concatenate([np.linspace(best, median, half), np.linspace(median, worst, half)])
    order = ranking(scenes)
    return [order[rank] for rank in np.unique(ranks.round().astype(int))]

"""Score predictors on stored scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch

from rfpp.errors import ShardError
from rfpp.evaluation.measuring.predictors import Predictor, StoredScene
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.metrics.image import ImageMetrics
from rfpp.shards.dataset import ShardSplit


@torch.no_grad()
def score(
    predictors: Sequence[Predictor],
    split: ShardSplit,
    metrics: ImageMetrics,
    device: torch.device,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[SceneRecord]:
    """Score every predictor on every scene of a split.

    Raises:
        ShardError: If the split is empty or a sample is damaged.
        UserError: If a predictor cannot render the stored resolution.
    """
    if len(split) == 0:
        raise ShardError(f"{split.manifest.root}: split '{split.split}' is empty: choose another in evaluation.splits")
    records = []
    for index in range(len(split)):
        progress(index, len(split))
        scene = StoredScene.of(split[index], device)
        triangles = scene.sample.triangles
        sizes = (len(triangles), triangles.num_objects, triangles.num_lights)
        for predictor in predictors:
            values = metrics(predictor.predict(scene), scene.reference, scene.gbuffer)
            columns = zip(*(column.tolist() for column in values.values()), strict=True)
            views = [dict(zip(values, numbers, strict=True)) for numbers in columns]
            records.append(SceneRecord(split.split, scene.sample.key, *sizes, predictor.name, views))
    progress(len(split), len(split))
    return records

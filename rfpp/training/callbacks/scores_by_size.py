"""Validation scores by scene size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import lightning as L
import numpy as np
import torch
from torch import Tensor

from rfpp.batch import RaggedBatch


class ScoresBySize(L.Callback):
    """Logs the mean of every metric over validation scenes, by range of triangle counts.

    As `validation_log_l1/1000_to_2999_triangles` and so on; ranges without a scene are left out.

    Args:
        edges: where one range ends and the next begins, in triangles.
    """

    def __init__(self, edges: Sequence[int]):
        self.edges = list(edges)

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        names = module.metrics.names
        self._sums = torch.zeros(len(self.edges) + 1, len(names) + 1, dtype=torch.float64)  # the last: how many scenes

    def on_validation_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Mapping[str, Tensor],
        batch: RaggedBatch,
        batch_index: int,
        dataloader_index: int = 0,
    ) -> None:
        by_scene = [outputs[name].view(len(batch.scenes), -1).mean(1) for name in module.metrics.names]
        rows = torch.stack([*by_scene, torch.ones_like(by_scene[0])], dim=1).double().cpu()
        self._sums.index_add_(0, torch.from_numpy(np.digitize(triangles(batch), self.edges)), rows)

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        sums = trainer.strategy.reduce(self._sums.float().to(module.device), reduce_op="sum").cpu()
        means = {
            f"validation_{name}/{label}": float(row[i] / row[-1])
            for label, row in zip(labels(self.edges), sums, strict=True)
            for i, name in enumerate(module.metrics.names)
            if row[-1] > 0
        }
        for logger in trainer.loggers if trainer.is_global_zero else ():
            logger.log_metrics(means, step=trainer.global_step - 1)  # Lightning counts from 0: as all others


def triangles(batch: RaggedBatch) -> list[int]:
    """Triangle counts of a batch's scenes."""
    ends = np.cumsum([0, *batch.scenes.lengths])
    return [sum(batch.objects.lengths[a:b]) for a, b in pairwise(ends)]


def labels(edges: Sequence[int]) -> list[str]:
    """Labels of the ranges, valid in MLflow's metric names."""
    inner = [f"{a}_to_{b - 1}_triangles" for a, b in pairwise([0, *edges])]
    return [*inner, f"{edges[-1]}_triangles_and_more"]

"""Warn of spikes in the loss and the gradient norm, and stop a training run that has diverged."""

from __future__ import annotations

import warnings
from collections import defaultdict, deque
from statistics import median
from typing import Any

import lightning as L

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError

#: Metrics that are watched. They are equal on all ranks, which therefore stop together.
WATCHED = ("train/loss", "train/gradient_norm")
#: Logged steps of which the median is taken.
WINDOW = 20


class DivergenceError(UserError):
    """Training has diverged; raised on all ranks."""


class DivergenceAlarm(L.Callback):
    """Warns at logged steps where the loss or the gradient norm exceeds a multiple of its recent median.

    Args:
        factor: The multiple.
        patience: Consecutive logged steps with such a loss after which training stops; None: it never stops.
    """

    def __init__(self, factor: float, patience: int | None):
        self.factor, self.patience = factor, patience
        self._recent: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=WINDOW))
        self._spikes = 0

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: Any, batch: RaggedBatch, batch_index: int
    ) -> None:
        is_step = (batch_index + 1) % trainer.accumulate_grad_batches == 0
        if not is_step or trainer.global_step % trainer.log_every_n_steps != 0:
            return
        spikes = [name in trainer.callback_metrics and self._is_spike(name, trainer) for name in WATCHED]
        self._spikes = self._spikes + 1 if spikes[0] else 0
        if self.patience is not None and self._spikes >= self.patience:
            raise DivergenceError(
                f"step {trainer.global_step}: training has diverged: go back with checkpoint=<run_dir>/checkpoints/"
                "step-….ckpt, and resume with a smaller optimizer.lr"
            )

    def _is_spike(self, name: str, trainer: L.Trainer) -> bool:
        value, recent = float(trainer.callback_metrics[name]), self._recent[name]
        if len(recent) < WINDOW or value <= self.factor * median(recent):
            recent.append(value)
            return False
        if trainer.is_global_zero:
            ratio = value / median(recent)
            warnings.warn(f"step {trainer.global_step}: {name} is {ratio:.0f} times its recent median", stacklevel=2)
        return True

"""Warn of spikes in the loss and the gradient norm, stop a run that has diverged, and omit the steps at fault."""

from __future__ import annotations

import warnings
from collections import defaultdict, deque
from pathlib import Path
from statistics import median
from typing import Any

import lightning as L
from torch.optim import Optimizer

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.ranges import Positive
from rfpp.training.rollback import omitted_steps

#: Metrics that are watched. They are equal on all ranks, which therefore stop together.
WATCHED = ("train/loss", "train/gradient_norm")
#: Logged steps of which the median is taken.
WINDOW = 20


class DivergenceError(UserError):
    """Training has diverged; raised on all ranks.

    Attributes:
        steps: From the last logged step whose loss, that before its update, is usual, to the first whose loss is high.
    """

    def __init__(self, step: int, steps: range):
        super().__init__(
            f"step {step}: training has diverged: go back with checkpoint=<run_dir>/checkpoints/step-….ckpt, and "
            "resume with a smaller optimizer.lr or with roll_backs=1"
        )
        self.steps = steps


class DivergenceAlarm(L.Callback):
    """Warns at logged steps where the loss or the gradient norm exceeds a multiple of its recent median.

    Steps that a run omits (`omit_steps`) have zero gradients.

    Args:
        run_dir: Folder of the run.
        factor: The multiple.
        patience: Consecutive logged steps with such a loss after which training stops; None: it never stops.
    """

    def __init__(self, run_dir: str, factor: float, patience: Positive | None):
        self.run_dir, self.factor, self.patience = Path(run_dir), factor, patience
        self._recent: dict[str, deque[float]] = defaultdict(lambda: deque(maxlen=WINDOW))
        self._spikes = 0

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._omitted = omitted_steps(self.run_dir)

    def on_before_optimizer_step(self, trainer: L.Trainer, module: L.LightningModule, optimizer: Optimizer) -> None:
        if any(trainer.global_step + 1 in steps for steps in self._omitted):
            for group in optimizer.param_groups:
                for parameter in group["params"]:
                    if parameter.grad is not None:
                        parameter.grad.zero_()

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: Any, batch: RaggedBatch, batch_index: int
    ) -> None:
        is_step = (batch_index + 1) % trainer.accumulate_grad_batches == 0
        if not is_step or trainer.global_step % trainer.log_every_n_steps != 0:
            return
        spikes = [name in trainer.callback_metrics and self._is_spike(name, trainer) for name in WATCHED]
        self._spikes = self._spikes + 1 if spikes[0] else 0
        if self.patience is not None and self._spikes >= self.patience:
            first = trainer.global_step - (self.patience - 1) * trainer.log_every_n_steps
            raise DivergenceError(trainer.global_step, range(max(first - trainer.log_every_n_steps, 1), first + 1))

    def _is_spike(self, name: str, trainer: L.Trainer) -> bool:
        value, recent = float(trainer.callback_metrics[name]), self._recent[name]
        if len(recent) < WINDOW or value <= self.factor * median(recent):
            recent.append(value)
            return False
        if trainer.is_global_zero:
            ratio = value / median(recent)
            warnings.warn(f"step {trainer.global_step}: {name} is {ratio:.0f} times its recent median", stacklevel=2)
        return True

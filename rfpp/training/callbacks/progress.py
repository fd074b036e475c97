"""Progress of training: a bar in a terminal, log lines elsewhere."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import lightning as L
from rich.console import Console

from rfpp.progress import counting


class TrainingProgress(L.Callback):
    """Progress bar of the run's optimizer steps, with the last logged loss, on rank 0."""

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._bar = ExitStack()
        self._show = None
        if trainer.is_global_zero:
            self._show, _ = self._bar.enter_context(counting(Console(highlight=False, soft_wrap=True), "steps"))
            self._show(trainer.global_step, trainer.max_steps)

    def on_train_batch_end(self, trainer: L.Trainer, module: L.LightningModule, *_: Any) -> None:
        if self._show is None:
            return
        note = None
        is_logged = trainer.global_step and trainer.global_step % trainer.log_every_n_steps == 0
        if is_logged and "train/loss" in trainer.callback_metrics:  # reading it waits for the device
            note = f"loss {trainer.callback_metrics['train/loss']:.4f}"
        self._show(trainer.global_step, trainer.max_steps, note)

    def on_train_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._bar.close()

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        if "_bar" in self.__dict__:  # training had started
            self._bar.close()

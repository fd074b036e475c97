"""Checkpoints to go on from, at step boundaries: every so many steps, at the end, and when told to stop."""

from __future__ import annotations

from pathlib import Path

import lightning as L
from lightning.pytorch.callbacks import Checkpoint
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch
from rfpp.training.checkpoints import keep_newest, point_at, step_file
from rfpp.training.stopping import StoppedError, StopSignals


class ResumableCheckpoints(Checkpoint):
    """Writes `step-00000500.ckpt` into a folder, and makes `last.ckpt` a link to the newest.

    A boundary lies after an optimizer step, and after the validation that follows on it, so that a run that goes on
    neither repeats nor misses one. A signal to stop is acted on there too: the ranks agree, save and raise.

    Args:
        folder: of the run's checkpoints.
        every_n_steps: how often; the last step is always saved.
        keep: how many of the newest.
    """

    def __init__(self, folder: str, every_n_steps: int, keep: int):
        self.folder, self.every_n_steps, self.keep = Path(folder), every_n_steps, keep
        self.signals = StopSignals()

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._saved = trainer.global_step
        self.signals.watch()

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: STEP_OUTPUT, batch: RaggedBatch, batch_index: int
    ) -> None:
        batches = batch_index + 1
        stepped = batches % trainer.accumulate_grad_batches == 0
        validates = sum(trainer.num_val_batches) > 0 and batches % trainer.val_check_batch == 0
        if stepped and not validates:
            self._boundary(trainer)

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._boundary(trainer)

    def _boundary(self, trainer: L.Trainer) -> None:
        if trainer.fast_dev_run:
            return
        step = trainer.global_step
        received = self.signals.agreed(trainer.strategy)
        due = step - self._saved >= self.every_n_steps or step == trainer.max_steps
        if step > self._saved and (due or received):
            self._save(trainer, step)
        if received and step < trainer.max_steps:
            raise StoppedError(f"stopped by {received.name} after step {step} of {trainer.max_steps}", received)

    def _save(self, trainer: L.Trainer, step: int) -> None:
        path = step_file(self.folder, step)
        trainer.save_checkpoint(path)
        self._saved = step
        if trainer.is_global_zero:
            point_at(path, self.folder / "last.ckpt")
            keep_newest(self.folder, self.keep)

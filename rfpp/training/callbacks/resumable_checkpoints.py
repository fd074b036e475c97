"""Resumable checkpoints at step boundaries: periodically, at the end, and on request to stop."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import lightning as L
from lightning.pytorch.callbacks import Checkpoint
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch
from rfpp.training.checkpoint_files import keep_newest, point_at, step_file
from rfpp.training.signals import STOP_SIGNALS
from rfpp.training.stopping import Agreement, StoppedError

#: A checkpoint by time waits for so many times what the last one took: it may take a twentieth of the time.
PATIENCE = 20


class ResumableCheckpoints(Checkpoint):
    """Writes `step-00000500.ckpt` into a folder, and makes `last.ckpt` a link to the newest.

    A boundary lies after an optimizer step, and after the validation that follows on it, so that a run that goes on
    neither repeats nor misses one. A signal to stop is acted on there too: the ranks agree, save and raise.

    Args:
        folder: of the run's checkpoints.
        every_n_steps: how often; the last step is always saved.
        every_n_minutes: how often at least, by the first rank's clock, unless saving takes so long that it would be
            more than a twentieth of the time; None: never by time.
        keep: how many of the newest.
    """

    def __init__(self, folder: str, every_n_steps: int, every_n_minutes: float | None, keep: int):
        self.folder, self.keep = Path(folder), keep
        self.every_n_steps, self.every_n_minutes = every_n_steps, every_n_minutes

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._saved, self._saved_at, self._took = trainer.global_step, monotonic(), 0.0
        self._agreed = Agreement(trainer.world_size)
        STOP_SIGNALS.watch()
        received, _ = self._agreed(STOP_SIGNALS.take(), due=False)
        if received and not trainer.fast_dev_run:  # while the program was starting
            when = f"before step {self._saved + 1} of {trainer.max_steps}, with nothing to save"
            raise StoppedError(f"stopped by {received.name} {when}", received)

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
        received, due = self._agreed(STOP_SIGNALS.take(), trainer.is_global_zero and self._due_by_time())
        due = due or step - self._saved >= self.every_n_steps or step == trainer.max_steps
        if step > self._saved and (due or received):
            self._save(trainer, step)
        if received and step < trainer.max_steps:
            raise StoppedError(f"stopped by {received.name} after step {step} of {trainer.max_steps}", received)

    def _due_by_time(self) -> bool:
        if self.every_n_minutes is None:
            return False
        return monotonic() - self._saved_at >= max(60 * self.every_n_minutes, PATIENCE * self._took)

    def _save(self, trainer: L.Trainer, step: int) -> None:
        begin = monotonic()
        path = step_file(self.folder, step)
        trainer.save_checkpoint(path)
        if trainer.is_global_zero:
            point_at(path, self.folder / "last.ckpt")
            keep_newest(self.folder, self.keep)
        self._saved, self._saved_at = step, monotonic()
        self._took = self._saved_at - begin

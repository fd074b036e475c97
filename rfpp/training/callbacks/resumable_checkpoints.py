"""Resumable checkpoints at step boundaries: by steps, by time, at the end, on a signal to stop, and after an error."""

from __future__ import annotations

import math
import warnings
from functools import partial
from pathlib import Path
from time import monotonic
from typing import cast

import lightning as L
from lightning.pytorch.callbacks import Checkpoint

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.ranges import Positive
from rfpp.training.callbacks.divergence import DivergenceError
from rfpp.training.callbacks.finite_gradients import NonFiniteGradientError
from rfpp.training.checkpoint_files import BackgroundCheckpointIO, keep_newest, point_at, step_file
from rfpp.training.signals import STOP_SIGNALS
from rfpp.training.stopping import Agreement, StoppedError

#: A checkpoint by time is postponed until training has taken this many times as long as saving.
MIN_TRAINING_PER_SAVING = 20


class ResumableCheckpoints(Checkpoint):
    """Writes `step-00000500.ckpt` into a folder, and links `last.ckpt` to the newest.

    A step ends when the next one begins: then its metrics are logged and the validation after it has run, so a
    resumed run repeats neither. Stop signals are handled there too: ranks agree, save, and raise StoppedError. An error
    in the next step leaves the last one as it is; that is saved, too, unless other ranks are unaware of the error.

    Args:
        every_n_steps: Multiples of this are saved, and the last step.
        every_n_minutes: Maximum time between checkpoints, by the first rank's clock, unless saving took more than a
            twentieth of it; None: by steps only.
        keep: The newest ones to keep.
        keep_every_n_steps: Multiples of this are kept besides, as milestones.
    """

    def __init__(
        self,
        folder: str,
        every_n_steps: Positive,
        every_n_minutes: float | None,
        keep: Positive,
        keep_every_n_steps: Positive,
    ):
        counts = {"every_n_steps": every_n_steps, "keep": keep, "keep_every_n_steps": keep_every_n_steps}
        for name, count in counts.items():
            if count < 1:
                raise ValueError(f"callbacks.checkpoints.{name}={count}: use 1 or more")
        self.folder, self.keep, self.keep_every_n_steps = Path(folder), keep, keep_every_n_steps
        self.every_n_steps, self.every_n_minutes = every_n_steps, every_n_minutes
        self._saved_step = math.inf  # before training there is nothing to save

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._saved_step, self._saved_at, self._saving_seconds = trainer.global_step, monotonic(), 0.0
        self._agree = Agreement(trainer.world_size)
        STOP_SIGNALS.watch()

    def on_train_batch_start(
        self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, batch_index: int
    ) -> None:
        if batch_index % trainer.accumulate_grad_batches == 0:
            self._end_step(trainer)

    def on_train_epoch_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._end_step(trainer)

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        is_known_to_all = trainer.world_size == 1 or isinstance(exception, NonFiniteGradientError)
        is_worth_it = trainer.training and not isinstance(exception, DivergenceError)
        step = trainer.global_step
        if step > self._saved_step and is_known_to_all and is_worth_it:
            try:
                self._save(trainer, step, is_last=True)
            except (UserError, RuntimeError) as error:  # a full disk, or a GPU that fails: `exception` matters more
                warnings.warn(f"step {step} could not be saved ({error})", stacklevel=2)

    def _end_step(self, trainer: L.Trainer) -> None:
        step = trainer.global_step
        received, due = self._agree(STOP_SIGNALS.take(), trainer.is_global_zero and self._is_due_by_time())
        due = due or any(step // n > self._saved_step // n for n in (self.every_n_steps, self.keep_every_n_steps))
        due = due or step == trainer.max_steps
        if step > self._saved_step and (due or received):
            self._save(trainer, step, is_last=bool(received) or step == trainer.max_steps)
        if received and step < trainer.max_steps:
            raise StoppedError(f"stopped by {received.name} after step {step} of {trainer.max_steps}", received)

    def _is_due_by_time(self) -> bool:
        if self.every_n_minutes is None:
            return False
        wait = max(60 * self.every_n_minutes, MIN_TRAINING_PER_SAVING * self._saving_seconds)
        return monotonic() - self._saved_at >= wait

    def _save(self, trainer: L.Trainer, step: int, is_last: bool) -> None:
        begin = monotonic()
        path = step_file(self.folder, step)
        trainer.save_checkpoint(path, storage_options=partial(self._replace_older, path))
        if is_last and trainer.is_global_zero:
            cast(BackgroundCheckpointIO, trainer.strategy.checkpoint_io).wait()
        self._saved_step, self._saved_at = step, monotonic()
        self._saving_seconds = self._saved_at - begin

    def _replace_older(self, path: Path) -> None:
        point_at(path, path.with_name("last.ckpt"))
        keep_newest(path.parent, self.keep, self.keep_every_n_steps)

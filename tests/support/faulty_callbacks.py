"""Callbacks by which ranks differ, one behind the other or with another clock, and one that fails."""

import time

import lightning as L

from rfpp.training.callbacks.resumable_checkpoints import ResumableCheckpoints


class Skewed(L.Callback):
    """The second rank sleeps before every batch, so that the first one waits for it inside the all-reduce."""

    def on_train_batch_start(self, trainer, module, batch, batch_index) -> None:
        if trainer.global_rank == 1:
            time.sleep(0.3)


class LateClock(L.Callback):
    """The second rank's clock for checkpoints says that one is always due."""

    def on_train_start(self, trainer, module) -> None:
        if trainer.global_rank == 1:
            [checkpoints] = [c for c in trainer.callbacks if isinstance(c, ResumableCheckpoints)]
            checkpoints.every_n_minutes = 0.0


class Failing(L.Callback):
    """Fails in the middle of the sixth step."""

    def on_before_optimizer_step(self, trainer, module, optimizer) -> None:
        if trainer.global_step == 5:
            raise RuntimeError("a failure of the sixth step")

"""A callback that keeps one rank behind the other."""

import time

import lightning as L


class Skewed(L.Callback):
    """The second rank sleeps before every batch, so that the first one waits for it inside the all-reduce."""

    def on_train_batch_start(self, trainer, module, batch, batch_index) -> None:
        if trainer.global_rank == 1:
            time.sleep(0.3)

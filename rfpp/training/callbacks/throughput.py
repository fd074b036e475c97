"""How fast training goes, and how much of the time it waits for data."""

from __future__ import annotations

import time

import lightning as L
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch


class Throughput(L.Callback):
    """Logs steps, scenes, images and triangles per second, and the share of time spent waiting for data.

    Args:
        every_n_steps: averaging window.
    """

    def __init__(self, every_n_steps: int):
        self.every_n_steps = every_n_steps
        self._reset()
        self._batch_end = None

    def _reset(self) -> None:
        self._since, self._waited = time.perf_counter(), 0.0
        self._batches = self._scenes = self._images = self._triangles = 0

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._reset()
        self._batch_end = time.perf_counter()

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        self._waited += time.perf_counter() - self._batch_end

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: STEP_OUTPUT, batch: RaggedBatch, batch_index: int
    ) -> None:
        devices = trainer.world_size
        self._batches += 1
        self._scenes += devices * len(batch.scenes)
        self._images += devices * len(batch.scenes) * batch.num_views
        self._triangles += devices * batch.objects.total
        if (batch_index + 1) % self.every_n_steps == 0:
            elapsed = time.perf_counter() - self._since
            rates = {
                "batches_per_s": self._batches,
                "scenes_per_s": self._scenes,
                "images_per_s": self._images,
                "triangles_per_s": self._triangles,
                "data_wait_fraction": self._waited,
            }
            module.log_dict({f"throughput/{name}": count / elapsed for name, count in rates.items()})
            self._reset()
        self._batch_end = time.perf_counter()

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._reset()  # validation is not training time
        self._batch_end = time.perf_counter()

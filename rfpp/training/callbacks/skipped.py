"""How many damaged scenes training went without."""

from __future__ import annotations

import lightning as L
import torch
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch


class SkippedScenes(L.Callback):
    """Logs `data/skipped`: scenes missing from this run's batches since it was started or resumed, over all devices."""

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._skipped = torch.zeros((), device=module.device)

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: STEP_OUTPUT, batch: RaggedBatch, batch_index: int
    ) -> None:
        expected = trainer.datamodule.scenes_per_step // trainer.world_size
        self._skipped += expected - len(batch.keys)
        if trainer.datamodule.skip_corrupt:
            module.log("data/skipped", self._skipped, reduce_fx="max", batch_size=len(batch.keys))

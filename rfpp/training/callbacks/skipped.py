"""Log the number of damaged scenes skipped."""

from __future__ import annotations

import lightning as L
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch


class SkippedScenes(L.Callback):
    """Logs `data/skipped`: scenes missing from the batches since the run was started or resumed, over all devices."""

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._skipped = 0

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: STEP_OUTPUT, batch: RaggedBatch, batch_index: int
    ) -> None:
        data = trainer.datamodule
        if data.source.skip_corrupt:
            self._skipped += data.scenes_per_batch - len(batch.keys)
            module.log("data/skipped", float(self._skipped), sync_dist=True, reduce_fx="sum", batch_size=1)

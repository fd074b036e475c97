"""Log the learning rate."""

from __future__ import annotations

import lightning as L

from rfpp.batch import RaggedBatch


class LearningRate(L.Callback):
    """Logs `train/learning_rate`; the parameter groups share it, see `decay_groups`."""

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        module.log("train/learning_rate", trainer.optimizers[0].param_groups[0]["lr"], batch_size=1)

"""Log at every validation whether the network uses its tokens and its operator."""

from __future__ import annotations

from collections.abc import Mapping

import lightning as L
import torch
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.losses.ablation import AblationErrors


class AblationMonitor(L.Callback):
    """Callback that logs the relative growth of the validation error per ablation (`rfpp.losses.ablation`).

    Metrics: `ablation/other_tokens`, `ablation/other_encoded_tokens`, `ablation/no_operator`, and `ablation/spread`
    (`token_spread`). With several processes, only rank 0's scenes are measured.
    """

    def __init__(self, scenes: int):
        self.scenes = scenes

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._errors = AblationErrors()

    @torch.no_grad()
    def on_validation_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Mapping[str, Tensor],
        batch: RaggedBatch,
        batch_index: int,
        dataloader_index: int = 0,
    ) -> None:
        if batch_index > self.scenes:
            return
        with trainer.precision_plugin.forward_context():
            self._errors.add(module.network, batch, log_encode(outputs["radiance"]))

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        growth = self._errors.growth()
        if not growth or trainer.sanity_checking or not trainer.is_global_zero:
            return
        measured = {**growth, "spread": self._errors.spread()}
        for logger in trainer.loggers:
            # Lightning counts steps from 0
            logger.log_metrics({f"ablation/{name}": value for name, value in measured.items()}, trainer.global_step - 1)

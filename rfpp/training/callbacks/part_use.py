"""Log at every validation whether the network uses its tokens, light and transport."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import lightning as L
import torch
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.losses.error_growth import EXCHANGED_TOKENS, ErrorGrowth


class PartUse(L.Callback):
    """Logs the relative growth of the validation error when one part of the network is disabled.

    Logged as `life/exchanged_tokens`, `life/exchanged_scene`, `life/permuted_light` and `life/no_transport`
    (`rfpp.losses.error_growth`). At 0 the part is not used. Warns once if a network does not read its scene tokens.
    With several processes, rank 0's scenes are used.

    Args:
        scenes: of validation, at most; the first has no other scene's tokens to be given and is left out.
        least: share of the error below which scene tokens count as not read.
    """

    def __init__(self, scenes: int, least: float):
        self.scenes, self.least = scenes, least
        self._warned = False

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._growth = ErrorGrowth()

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
            self._growth.add(module.network, batch, log_encode(outputs["radiance"]))

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        growth = {f"life/{what}": share for what, share in self._growth.shares().items()}
        if not growth or trainer.sanity_checking:
            return
        for logger in trainer.loggers if trainer.is_global_zero else ():
            logger.log_metrics(growth, step=trainer.global_step - 1)  # Lightning counts from 0: as all others
        if trainer.is_global_zero:
            self.judge(growth[f"life/{EXCHANGED_TOKENS}"])

    def judge(self, growth: float) -> None:
        """Warn once if the error hardly grows with another scene's tokens."""
        if growth < self.least and not self._warned:
            self._warned = True
            warnings.warn(
                f"the network hardly reads its scene tokens: with another scene's its error grows by {growth:.1%}",
                stacklevel=2,
            )

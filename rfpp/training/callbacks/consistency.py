"""Log the transport consistency residual of every iteration."""

from __future__ import annotations

import lightning as L
from torch import Tensor

from rfpp.batch import RaggedBatch


class ConsistencyMonitor(L.Callback):
    """Logs the residual of each transport iteration as `consistency/k1` … `consistency/kK`.

    `consistency/last_over_first` below 1 says that later states change less than early ones. Those of a network that
    has learned nothing do so, too: look at how it falls, beside the loss.
    """

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: dict[str, Tensor], batch: RaggedBatch, _: int
    ) -> None:
        residuals = {}
        while (term := outputs.get(f"consistency_{len(residuals) + 1}")) is not None:
            residuals[f"consistency/k{len(residuals) + 1}"] = term.detach()
        if not residuals:
            return
        values = list(residuals.values())
        residuals["consistency/last_over_first"] = values[-1] / values[0].clamp(min=1e-12)
        module.log_dict(residuals, batch_size=len(batch.keys))

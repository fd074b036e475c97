"""Log memory use."""

from __future__ import annotations

import lightning as L
import psutil
import torch
from lightning.pytorch.utilities.types import STEP_OUTPUT

from rfpp.batch import RaggedBatch

GIB = 2**30


class Memory(L.Callback):
    """Logs GiB: on a GPU `memory/allocated` and `memory/peak` since the last log, else `memory/resident`.

    The first two are PyTorch's allocator's, the third is the process's without its loaders.
    """

    def on_train_batch_end(
        self, trainer: L.Trainer, module: L.LightningModule, outputs: STEP_OUTPUT, batch: RaggedBatch, batch_index: int
    ) -> None:
        if (trainer.global_step % trainer.log_every_n_steps) != 0:
            return
        device = trainer.strategy.root_device
        if device.type == "cuda":
            used = {
                "memory/allocated": torch.cuda.memory_allocated(device) / GIB,
                "memory/peak": torch.cuda.max_memory_allocated(device) / GIB,
            }
            torch.cuda.reset_peak_memory_stats(device)
        else:
            used = {"memory/resident": psutil.Process().memory_info().rss / GIB}
        module.log_dict(used, batch_size=1)

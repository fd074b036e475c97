"""Stop training before a step with non-finite gradients."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import lightning as L
import torch
from safetensors.torch import save
from torch import Tensor
from torch.optim import Optimizer

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.segments import Segments


class NonFiniteGradientError(UserError):
    """A loss or gradient is NaN or infinite on some rank; raised on all ranks."""


class FiniteGradients(L.Callback):
    """Stops before a step with non-finite gradients, and writes its global batch.

    A loss that is not finite on one rank is a gradient that is not finite on all, once they have been averaged: no
    further agreement is needed. Each rank writes its share: `step-00000012-rank0-batch0.safetensors`, every tensor of
    the batch, with keys, loss, step, rank in the file's metadata.

    Args:
        folder: where to write.
    """

    def __init__(self, folder: str):
        self.folder = Path(folder)
        self._batches: list[RaggedBatch] = []
        self._losses: list[Tensor] = []

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        self._batches.append(batch)

    def on_before_backward(self, trainer: L.Trainer, module: L.LightningModule, loss: Tensor) -> None:
        self._losses.append(loss.detach())

    def on_before_optimizer_step(self, trainer: L.Trainer, module: L.LightningModule, optimizer: Optimizer) -> None:
        gradients = [p.grad for group in optimizer.param_groups for p in group["params"] if p.grad is not None]
        if torch.nn.utils.get_total_norm(gradients).isfinite():
            self._batches, self._losses = [], []
            return
        step, rank = trainer.global_step + 1, trainer.global_rank
        for i, (batch, loss) in enumerate(zip(self._batches, self._losses, strict=True)):
            value = float(loss) * trainer.accumulate_grad_batches  # Lightning has divided by it
            about = {"keys": json.dumps(batch.keys), "loss": str(value), "step": str(step), "rank": str(rank)}
            name = f"step-{step:08d}-rank{rank}-batch{i}.safetensors"
            write_atomically(self.folder / name, save(batch_tensors(batch), about))
        raise NonFiniteGradientError(
            f"step {step}: the loss or its gradient is not finite; the weights are those of the step before and the "
            f"batch is in {self.folder}: look at it, then go on with another optimizer.lr, precision or data"
        )


def batch_tensors(batch: RaggedBatch) -> dict[str, Tensor]:
    """Every tensor of a batch by its name; segments by their offsets."""
    values = {field.name: getattr(batch, field.name) for field in fields(batch)}
    values |= {name: value.offsets for name, value in values.items() if isinstance(value, Segments)}
    return {name: value.contiguous().cpu() for name, value in values.items() if isinstance(value, Tensor)}

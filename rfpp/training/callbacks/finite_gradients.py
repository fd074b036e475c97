"""Stop training before a step with non-finite gradients, or skip it."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import lightning as L
import torch
from torch import Tensor
from torch.optim import Optimizer

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.files import write_atomically


class NonFiniteGradientError(UserError):
    """A loss or gradient is NaN or infinite; raised on all ranks."""


class FiniteGradients(L.Callback):
    """Stops before a step with non-finite gradients, and writes the keys and losses of its batches.

    Ranks need no agreement: averaging spreads a non-finite gradient to all of them. Each rank writes the batches of
    its device to `step-00000012-rank0.json`. The first `skip` such steps are made with zero gradients, with a warning.
    """

    def __init__(self, folder: str, skip: int):
        self.folder, self._skips_left = Path(folder), skip
        self._batches: list[tuple[tuple[str, ...], Tensor]] = []

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        self._keys = batch.keys

    def on_before_backward(self, trainer: L.Trainer, module: L.LightningModule, loss: Tensor) -> None:
        self._batches.append((self._keys, loss.detach()))

    def on_before_optimizer_step(self, trainer: L.Trainer, module: L.LightningModule, optimizer: Optimizer) -> None:
        batches, self._batches = self._batches, []
        gradients = [p.grad for group in optimizer.param_groups for p in group["params"] if p.grad is not None]
        if torch.nn.utils.get_total_norm(gradients).isfinite():
            return
        step = trainer.global_step + 1
        scale = trainer.accumulate_grad_batches  # Lightning has divided the loss by it
        content = [{"scenes": list(keys), "loss": str(float(loss) * scale)} for keys, loss in batches]
        file = self.folder / f"step-{step:08d}-rank{trainer.global_rank}.json"
        write_atomically(file, json.dumps(content, indent=1).encode())
        if self._skips_left > 0:
            self._skips_left -= 1
            for gradient in gradients:
                gradient.zero_()
            warnings.warn(f"step {step} is skipped: its gradient is not finite; {file} lists its scenes", stacklevel=2)
            return
        raise NonFiniteGradientError(
            f"step {step}: the loss or its gradient is not finite; the weights are those before this step, and {file} "
            "lists its scenes: resume with another optimizer.lr, precision or data, or skip it "
            "(callbacks.finite_gradients.skip=1)"
        )

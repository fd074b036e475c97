"""State missing from Lightning checkpoints for bit-exact resumption: random states and rank-independent counters."""

from __future__ import annotations

import random
from typing import Any

import lightning as L
import numpy as np
import torch
import torch.distributed as dist

from rfpp.batch import RaggedBatch

#: Where a checkpoint keeps the random state of each rank.
RANDOM_KEY = "random_states"


class ExactResume(L.Callback):
    """Saves the random state of every rank; corrects loop counters if the division of batches has changed.

    A run may go on with another number of ranks: the data's order does not depend on it, and ranks that were not there
    before are seeded anew.
    """

    def __init__(self) -> None:
        self._states: list[dict[str, Any]] | None = None

    def on_save_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        states: list[Any] = [None] * trainer.world_size
        if trainer.world_size > 1:
            dist.all_gather_object(states, random_state())
        else:
            states = [random_state()]
        checkpoint[RANDOM_KEY] = states

    def on_load_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        self._states = checkpoint[RANDOM_KEY]
        batches = checkpoint["global_step"] * trainer.accumulate_grad_batches
        progress = checkpoint["loops"]["fit_loop"]["epoch_loop.batch_progress"]
        for counts in (progress["total"], progress["current"]):
            begun = counts["ready"] - counts["completed"]  # 1 where it was saved before the batch was done with
            counts.update(ready=batches, started=batches, processed=batches, completed=batches - begun)

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        # not earlier: what is set up before the first batch may draw random numbers
        if self._states is None:
            return
        states, self._states = self._states, None
        rank = trainer.global_rank
        restore_random_state(states[min(rank, len(states) - 1)])
        if rank >= len(states):
            torch.manual_seed(torch.initial_seed() + rank)


def random_state() -> dict[str, Any]:
    """The state of every generator of this process, as tensors and plain values."""
    version, internal, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002 libraries may draw from it
    return {
        "python": [version, torch.tensor(internal, dtype=torch.int64), gauss],
        "numpy": [name, torch.from_numpy(keys.astype(np.int64)), position, has_gauss, cached],
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state() if torch.cuda.is_available() else None,
    }


def restore_random_state(state: dict[str, Any]) -> None:
    version, internal, gauss = state["python"]
    random.setstate((version, tuple(internal.tolist()), gauss))
    name, keys, position, has_gauss, cached = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), position, has_gauss, cached))  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    if state["cuda"] is not None and torch.cuda.is_available():
        torch.cuda.set_rng_state(state["cuda"])

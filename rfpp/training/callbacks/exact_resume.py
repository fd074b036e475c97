"""Resume a run bit by bit: state that Lightning's checkpoints lack, and loop counters for any number of ranks."""

from __future__ import annotations

import random
from typing import Any

import lightning as L
import numpy as np
import torch
import torch.distributed as dist

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError

#: Key of the random states of all ranks in a checkpoint.
RANDOM_KEY = "random_states"


class ExactResume(L.Callback):
    """Saves and restores the random state of every rank, and restarts Lightning's loops after the checkpoint's step.

    A run may be resumed with another number of ranks: the order of the data does not depend on it. Additional ranks
    get new random states.
    """

    def __init__(self) -> None:
        self._states: list[dict[str, Any]] | None = None

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        """Require all ranks to begin after the same step; else raise UserError on all, which would wait for ever."""
        steps = [trainer.global_step] * trainer.world_size
        if trainer.world_size > 1:
            dist.all_gather_object(steps, trainer.global_step)
        if len(set(steps)) > 1:
            raise UserError(f"ranks found checkpoints of different steps ({steps}): put run_dir where all can see it")

    def on_save_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        states: list[Any] = [random_state()]
        if trainer.world_size > 1:
            states = [None] * trainer.world_size
            dist.all_gather_object(states, random_state())
        checkpoint[RANDOM_KEY] = states

    def on_load_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        self._states = checkpoint[RANDOM_KEY]
        restart_after(checkpoint["loops"]["fit_loop"], checkpoint["global_step"], trainer.accumulate_grad_batches)

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        # not earlier: setting up training may draw random numbers
        if self._states is None:
            return
        states, self._states = self._states, None
        rank = trainer.global_rank
        restore_random_state(states[min(rank, len(states) - 1)])
        if rank >= len(states):
            torch.manual_seed(torch.initial_seed() + rank)


def restart_after(fit_loop: dict[str, Any], step: int, accumulate: int) -> None:
    """Set the loop counters of a checkpoint to those of one saved in Lightning's `on_train_batch_end`.

    Lightning resumes differently depending on the hook in which a checkpoint was saved, and counts batches, whose
    number per step changes with the number of ranks. Training has one epoch, see GlobalBatches.

    Args:
        step: Optimizer steps before the checkpoint.
        accumulate: Batches per step after it.
    """
    batches = step * accumulate
    progress = fit_loop["epoch_loop.batch_progress"]
    for counts in (progress["total"], progress["current"]):
        counts.update(ready=batches, started=batches, processed=batches, completed=batches - 1)
    progress["is_last_batch"] = False
    for counts in (fit_loop["epoch_progress"]["total"], fit_loop["epoch_progress"]["current"]):
        counts.update(ready=1, started=1, processed=0, completed=0)
    fit_loop["epoch_loop.state_dict"]["_batches_that_stepped"] = step - 1


def random_state() -> dict[str, Any]:
    """Return the state of every random generator of this process, as tensors and plain values."""
    version, internal, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002 (libraries may draw from it)
    return {
        "python": [version, torch.tensor(internal, dtype=torch.int64), gauss],
        "numpy": [name, torch.from_numpy(keys.astype(np.int64)), position, has_gauss, cached],
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state() if torch.cuda.is_available() else None,
    }


def restore_random_state(state: dict[str, Any]) -> None:
    """Restore what `random_state` returned."""
    version, internal, gauss = state["python"]
    random.setstate((version, tuple(internal.tolist()), gauss))
    name, keys, position, has_gauss, cached = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), position, has_gauss, cached))  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    if state["cuda"] is not None and torch.cuda.is_available():
        torch.cuda.set_rng_state(state["cuda"])

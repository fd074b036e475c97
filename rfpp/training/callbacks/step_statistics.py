"""Log losses, throughput, memory and skipped scenes of all devices."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from typing import Any

import lightning as L
import psutil
import torch

from rfpp.batch import RaggedBatch
from rfpp.ranges import Positive
from rfpp.training.flops import published_peak, training_flops

#: Steps between two batches whose floating-point operations are counted, which takes a forward pass.
COUNT_FLOPS_EVERY = 500
GIB = 2**30


class StepStatistics(L.Callback):
    """Logs statistics of all devices every n steps.

    `train/` and `consistency/`: loss terms, means over the scenes of the last step, however these are divided among
    devices and batches. The others are means since they were last logged, without validation:
    `throughput/`: steps, scenes, images, triangles and tokens (scene tokens and ray bundles) per second,
    `data_wait_fraction` of the device that waits longest, `data_wait_rank`, its rank, and, on GPUs whose peak rate is
    listed, `flop_utilization` (MFU): operations of the network's forward and backward passes as a fraction of that
    rate, without LPIPS.
    `memory/`: GiB. On a GPU `allocated`, and `peak` in the window, of PyTorch's allocator; else `resident` memory of
    the process without its loaders; of the device that uses most.
    `data/skipped`: scenes skipped since the run was started or resumed, over all devices.
    """

    def __init__(self, every_n_steps: Positive):
        self.every_n_steps = every_n_steps

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        dtype = torch.bfloat16 if trainer.precision.startswith("bf16") else torch.float32
        self._peak_rate = published_peak(trainer.strategy.root_device, dtype)
        self._counted_at = None
        self._skipped = 0
        self._one = torch.ones((), device=trainer.strategy.root_device)
        self._begin_window()

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        self._waited += time.perf_counter() - self._batch_end
        is_due = self._counted_at is None or trainer.global_step - self._counted_at >= COUNT_FLOPS_EVERY
        if self._peak_rate and is_due:
            self._counted_at = trainer.global_step
            begin = time.perf_counter()
            with trainer.precision_plugin.forward_context():
                self._flops = training_flops(module.network, batch)
            self._begin += time.perf_counter() - begin  # not training time

    def on_train_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Mapping[str, Any],
        batch: RaggedBatch,
        batch_index: int,
    ) -> None:
        sums = len(batch.keys) * torch.stack([*outputs["terms"].values(), self._one])
        self._sums = sums if batch_index % trainer.accumulate_grad_batches == 0 else self._sums + sums
        images = len(batch.keys) * batch.num_views
        height, width = batch.resolution
        bundles = images * (height // module.network.patch_size) * (width // module.network.patch_size)
        self._batches += 1
        self._skipped += trainer.datamodule.scenes_per_batch - len(batch.keys)
        self._counts.update(
            scenes=len(batch.keys),
            images=images,
            triangles=batch.objects.total,
            tokens=int(outputs["tokens"]) + bundles,
        )
        is_step = (batch_index + 1) % trainer.accumulate_grad_batches == 0
        if is_step and trainer.global_step % self.every_n_steps == 0:
            *sums, scenes = trainer.strategy.reduce(self._sums, reduce_op="sum")
            module.log_dict(
                {name: value / scenes.clamp(min=1) for name, value in zip(outputs["terms"], sums, strict=True)}
            )
            module.log_dict(self._statistics(trainer))
            self._begin_window()
        self._batch_end = time.perf_counter()

    def _statistics(self, trainer: L.Trainer) -> dict[str, float]:
        elapsed, device = time.perf_counter() - self._begin, trainer.strategy.root_device
        highest = {"throughput/data_wait_fraction": self._waited / elapsed} | _memory(device)
        counts = [*self._counts.values(), self._skipped]
        *counts, skipped = trainer.strategy.reduce(torch.tensor(counts, device=device), reduce_op="sum").tolist()
        gathered = trainer.strategy.all_gather(torch.tensor([*highest.values()], device=device))
        most, ranks = torch.atleast_2d(gathered).max(0)
        values = {
            "throughput/steps_per_s": self._batches / trainer.accumulate_grad_batches / elapsed,
            **{f"throughput/{name}_per_s": n / elapsed for name, n in zip(self._counts, counts, strict=True)},
            **dict(zip(highest, most.tolist(), strict=True)),
            "throughput/data_wait_rank": float(ranks[0]),
            "data/skipped": skipped,
        }
        if self._peak_rate:
            values["throughput/flop_utilization"] = self._flops * self._batches / elapsed / self._peak_rate
        return values

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._validation_begin = time.perf_counter()

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if not trainer.sanity_checking:
            seconds = time.perf_counter() - self._validation_begin
            self._begin, self._batch_end = self._begin + seconds, self._batch_end + seconds

    def _begin_window(self) -> None:
        self._begin = self._batch_end = time.perf_counter()
        self._waited, self._batches, self._counts = 0.0, 0, Counter()


def _memory(device: torch.device) -> dict[str, float]:
    """Return memory use in GiB, and reset PyTorch's peak."""
    if device.type != "cuda":
        return {"memory/resident": psutil.Process().memory_info().rss / GIB}
    used = {
        "memory/allocated": torch.cuda.memory_allocated(device) / GIB,
        "memory/peak": torch.cuda.max_memory_allocated(device) / GIB,
    }
    torch.cuda.reset_peak_memory_stats(device)
    return used

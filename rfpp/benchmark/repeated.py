"""A task of `rfpp.benchmark.cost.tasks`, repeated on one batch: seconds and peak of memory, or why not."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from statistics import median

import torch

from rfpp.batch import RaggedBatch
from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.benchmark.cost.turns import OK


@dataclass(frozen=True)
class Repeats:
    """How often each is measured.

    Attributes:
        warm_up: runs that choose and load kernels, or compile; not counted.
        least, most: runs that are counted.
        seconds: after so long no further one than `least`.
    """

    warm_up: int
    least: int
    most: int
    seconds: float | int


@dataclass
class Runs:
    """Attributes:
    seconds: of each quantity of the task, run by run.
    first_seconds: of the first run, which is not counted.
    peak: bytes at most, as CUDA's allocator counts; None on a CPU.
    status: OK, or why there are no figures.
    """

    seconds: dict[str, list[float]]
    first_seconds: float | None = None
    peak: int | None = None
    status: str = OK

    def median(self, quantity: str) -> float | None:
        """Seconds; None where it could not be measured."""
        seconds = self.seconds[quantity]
        return median(seconds) if seconds and self.status == OK else None


def repeated(made: Untrained, task: Task, batch: Case | RaggedBatch, setting: Setting, repeats: Repeats) -> Runs:
    """Run a task on a new network again and again. What it took is free afterwards.

    Args:
        batch: on the CPU, or what an invented one is like.
    """
    result = Runs({name: [] for name in task.quantities})
    on_gpu = setting.where == "cuda"
    if on_gpu:
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    run = network = None
    try:
        network = setting.network(made)
        on_host = batch.batch(network.gbuffer_channels, setting.seed) if isinstance(batch, Case) else batch
        run = task.prepared(network, on_host.to(setting.where), setting)
        begin = setting.now()
        run()
        result.first_seconds = setting.now() - begin
        for _ in range(repeats.warm_up - 1):
            run()
        begin = setting.now()
        for count in range(repeats.most):
            if count >= repeats.least and setting.now() - begin > repeats.seconds:
                break
            for name, value in run().items():
                result.seconds[name].append(value)
        result.peak = torch.cuda.max_memory_allocated() if on_gpu else None
    except torch.OutOfMemoryError:
        result.status = "out of memory"
    finally:
        del run, network
        gc.collect()
        torch.compiler.reset()
        if on_gpu:
            torch.cuda.empty_cache()
    return result

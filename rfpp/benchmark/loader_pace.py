"""How fast a training loader gives batches."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import lightning as L
import psutil

from rfpp.batch import RaggedBatch
from rfpp.training.datamodule import SceneDataModule

_PREFETCHED = 2  # batches that each process of a DataLoader is ahead


class Stopwatch:
    """Wall and CPU seconds since it was made, the latter with those of the processes that this one started."""

    def __init__(self) -> None:
        self._begin = self._now()

    def read(self) -> tuple[float, float]:
        return tuple(now - then for now, then in zip(self._now(), self._begin, strict=True))

    @staticmethod
    def _now() -> tuple[float, float]:
        this = psutil.Process()
        times = [process.cpu_times() for process in (this, *this.children(recursive=True))]
        return time.perf_counter(), sum(t.user + t.system for t in times)


@dataclass(frozen=True)
class LoaderPace:
    """Attributes:
    seconds, cpu_seconds: from one batch to so many later; of the CPU those of loader processes, too.
    batches: that were given in that time.
    """

    seconds: float
    cpu_seconds: float
    batches: tuple[RaggedBatch, ...]


def loader_pace(datamodule: SceneDataModule, batches: int, accelerator: str = "cpu") -> LoaderPace:
    """Time so many batches, while every loader process has work before and after; their start is not counted.

    Args:
        datamodule: see `SceneDataModule`; `workers` of its own.
        batches: to time.
        accelerator: where batches go, by Lightning's names: for "cuda" the loader pins their memory.
    """
    ahead = 1 + _PREFETCHED * datamodule.workers
    steps = batches + 2 * ahead
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        datamodule.trainer = L.Trainer(
            max_steps=steps, accelerator=accelerator, devices=1, logger=False, enable_checkpointing=False,
            enable_progress_bar=False,
        )  # fmt: skip
        loader = iter(datamodule.train_dataloader())
        for _ in range(ahead):
            next(loader)
        watch = Stopwatch()
        given = tuple(next(loader) for _ in range(batches))
        elapsed = watch.read()
        for _ in loader:  # PyTorch's processes may abort, with a message, if they are stopped while they send
            pass
    return LoaderPace(*elapsed, given)

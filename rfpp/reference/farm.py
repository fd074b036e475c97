"""A pool of pinned worker processes, recycled regularly and replaced when they die or hang."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import wait
from typing import TypeVar

from rfpp.errors import UserError
from rfpp.reference.worker import Limits, Slot, Task

Item = TypeVar("Item")
Result = TypeVar("Result")


class RenderFarm:
    """Runs jobs in worker processes that start with the first job and stay until `close`.

    Each worker owns its share of the cores from its very first instruction: it inherits the pinning when it is
    started, so every library sizes its thread pool for those cores alone (unpinned Cycles workers lose half their
    time waiting for each other). Processes are spawned, never forked, and replaced after `jobs_per_worker` jobs.

    Args:
        workers: number of processes; 0 means one per available core.
        jobs_per_worker: a worker is replaced by a fresh one after this many jobs, against slow leaks.
        max_growth_mb: or when it holds this much more memory than after its first job.
        max_job_seconds: a job that takes longer counts as hung: its worker is killed.

    Use as a context manager, or call `close`.
    """

    def __init__(
        self,
        workers: int,
        jobs_per_worker: int = 1000,
        max_growth_mb: float | int = math.inf,
        max_job_seconds: float | int = math.inf,
    ) -> None:
        if workers < 0:
            raise UserError(f"farm.workers is {workers}: use a positive number, or 0 for one per core")
        self._limits = Limits(jobs_per_worker, max_growth_mb, max_job_seconds)
        cores = _available_cores()
        count = workers or len(cores)
        self._slots = [Slot(_share(cores, i, count)) for i in range(count)]

    def __enter__(self) -> RenderFarm:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """The number of workers."""
        return len(self._slots)

    def close(self) -> None:
        """Stop all workers, also busy ones."""
        _stop(self._slots)

    def map(
        self, job: Callable[[Item], Result], items: Iterable[Item], attempts: int = 2
    ) -> Iterator[tuple[Item, Result | Exception]]:
        """Yield (item, what `job(item)` returned or raised) as they are finished; `items` is read lazily.

        An item whose job raises, whose worker dies (`WorkerDeathError`) or hangs (`WorkerHangError`) is tried
        `attempts` times in all; a `UserError` is final at once. `job`, items and results are pickled. Exceptions
        carry the worker's traceback as a note. Leaving the iteration early stops the workers that are still busy.
        """
        pending = (Task(item) for item in items)
        retries: list[Task] = []
        try:
            while True:
                for slot in (slot for slot in self._slots if slot.task is None):
                    if task := retries.pop() if retries else next(pending, None):
                        slot.begin(job, task)
                busy = [slot for slot in self._slots if slot.task is not None]
                if not busy:
                    return
                for slot in _ready(busy, self._limits):
                    task, result = slot.finish(self._limits)
                    failed = isinstance(result, Exception) and not isinstance(result, UserError)
                    if failed and task.attempt < attempts:
                        retries.append(Task(task.item, task.attempt + 1))
                    else:
                        yield task.item, result
        finally:
            _stop([slot for slot in self._slots if slot.task is not None])


def _stop(slots: list[Slot]) -> None:
    """Stop workers in parallel: notify all, then wait."""
    for slot in slots:
        slot.dismiss()
    for slot in slots:
        slot.stop()


def _ready(slots: list[Slot], limits: Limits) -> list[Slot]:
    """The busy slots that have an answer, a dead worker or a job beyond its time; waits for the first."""
    closed = [slot for slot in slots if slot.connection.closed]
    if closed:
        return closed
    patience = min(slot.began for slot in slots) + limits.seconds - time.monotonic()
    ready = wait([slot.connection for slot in slots], timeout=None if math.isinf(patience) else max(0, patience))
    now = time.monotonic()
    return [slot for slot in slots if slot.connection in ready or now - slot.began >= limits.seconds]


def _available_cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _share(cores: list[int], index: int, count: int) -> frozenset[int]:
    """The cores of worker `index` of `count`: equal runs, or one core for several workers when there are too few."""
    if count >= len(cores):
        return frozenset({cores[index % len(cores)]})
    return frozenset(cores[index * len(cores) // count : (index + 1) * len(cores) // count])

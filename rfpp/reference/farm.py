"""A pool of pinned worker processes, recycled regularly and replaced when they crash or hang."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import wait
from typing import TypeVar

from rfpp.errors import UserError
from rfpp.ranges import Positive, PositiveFloat
from rfpp.reference.worker import Limits, Slot, Task

Item = TypeVar("Item")
Result = TypeVar("Result")


class RenderFarm:
    """Runs jobs in worker processes that start with the first job and stay until `close`.

    A worker inherits its CPU pinning when it is started, so that every library sizes its thread pool accordingly
    (unpinned Cycles workers lose half their time waiting for each other). Processes are spawned, never forked.
    Use as a context manager, or call `close`.

    Args:
        workers: Number of processes; 0 is one per available core.
        jobs_per_worker: Jobs after which a worker is replaced, against slow leaks.
        max_growth_mb: Memory growth since its first job after which a worker is replaced.
        max_job_seconds: Time after which a job's worker is killed.
    """

    def __init__(
        self,
        workers: int,
        jobs_per_worker: Positive = 1000,
        max_growth_mb: float | int = math.inf,
        max_job_seconds: PositiveFloat = math.inf,
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
        """Return the number of workers."""
        return len(self._slots)

    def close(self) -> None:
        """Stop all workers, including busy ones."""
        _stop(self._slots)

    def map(
        self, job: Callable[[Item], Result], items: Iterable[Item], attempts: int = 2
    ) -> Iterator[tuple[Item, Result | Exception]]:
        """Yield (item, what `job(item)` returned or raised) in order of completion; `items` is read lazily.

        An item whose job raises, or whose worker crashes (`WorkerDeathError`) or hangs (`WorkerHangError`), is tried
        `attempts` times in total; a `UserError` is final. `job`, items and results are pickled. Exceptions carry the
        worker's traceback as a note. Leaving the iteration early stops busy workers.
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
    for slot in slots:
        slot.dismiss()
    for slot in slots:
        slot.stop()


def _ready(slots: list[Slot], limits: Limits) -> list[Slot]:
    """Wait for and return busy slots with an answer, a crashed worker or an overdue job."""
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
    """Return the cores of worker `index` of `count`: equal ranges, or one core shared by several workers."""
    if count >= len(cores):
        return frozenset({cores[index % len(cores)]})
    return frozenset(cores[index * len(cores) // count : (index + 1) * len(cores) // count])

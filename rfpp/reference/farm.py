"""Many jobs on many cores: worker processes that are pinned, recycled and replaced when they die."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from rfpp.errors import UserError

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Results waiting for an earlier, slower item may pile up to this many per worker.
_AHEAD_PER_WORKER = 8


class WorkerDeathError(RuntimeError):
    """A worker process ended in the middle of a job (crash, or killed for want of memory)."""


class RenderFarm:
    """Runs jobs in worker processes that start with the first job and stay until `close`.

    Each worker owns its share of the cores from its very first instruction: it inherits the pinning when it is
    started, so every library sizes its thread pool for those cores alone (unpinned Cycles workers lose half their
    time waiting for each other). Processes are spawned, never forked, and replaced after `jobs_per_worker` jobs.

    Args:
        workers: number of processes; 0 means one per available core.
        jobs_per_worker: a worker is replaced by a fresh one after this many jobs, against slow leaks.

    Use as a context manager, or call `close`.
    """

    def __init__(self, workers: int, jobs_per_worker: int = 1000) -> None:
        if workers < 0:
            raise UserError(f"workers is {workers}: use a positive number, or 0 for one per core")
        cores = _available_cores()
        count = workers or len(cores)
        self._jobs_per_worker = jobs_per_worker
        self._slots = [_Slot(_share(cores, i, count)) for i in range(count)]

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
        """Yield (item, what `job(item)` returned or raised) in the order of `items`, which is read lazily.

        An item whose job raises, or whose worker dies (`WorkerDeathError`), is tried `attempts` times in all; a
        `UserError` is final at once. `job`, items and results are pickled. Exceptions carry the worker's
        traceback as a note. Leaving the iteration early stops the workers that are still busy.
        """
        pending = enumerate(items)
        retries: list[_Task] = []
        done: dict[int, tuple[Item, Any]] = {}
        following = 0  # the index to yield next
        started = 0
        exhausted = False
        try:
            while True:
                for slot in (s for s in self._slots if s.task is None):
                    if retries:
                        task = retries.pop()
                    elif not exhausted and started < following + _AHEAD_PER_WORKER * len(self):
                        index, item = next(pending, (None, None))
                        if index is None:
                            exhausted = True
                            continue
                        started += 1
                        task = _Task(index, item)
                    else:
                        continue
                    slot.begin(job, task)
                if following in done:
                    yield done.pop(following)
                    following += 1
                    continue
                busy = [s for s in self._slots if s.task is not None]
                if not busy:
                    return
                for slot in _ready(busy):
                    task, result = slot.finish(self._jobs_per_worker)
                    failed = isinstance(result, Exception) and not isinstance(result, UserError)
                    if failed and task.attempt < attempts:
                        retries.append(_Task(task.index, task.item, task.attempt + 1))
                    else:
                        done[task.index] = (task.item, result)
        finally:
            _stop([slot for slot in self._slots if slot.task is not None])


@dataclass(frozen=True)
class _Task:
    index: int
    item: Any
    attempt: int = 1


@dataclass
class _Slot:
    """A place for one worker process on fixed cores."""

    cores: frozenset[int]
    task: _Task | None = None
    jobs_done: int = 0
    process: Any = field(default=None, repr=False)
    connection: Connection | None = field(default=None, repr=False)

    def begin(self, job: Callable, task: _Task) -> None:
        if self.process is None:
            self._start()
        self.task = task
        message = pickle.dumps((job, task.item))
        try:
            self.connection.send_bytes(message)
        except OSError:  # the idle worker was killed: `finish` will find it dead and the item is tried again
            self.connection.close()

    def finish(self, jobs_per_worker: int) -> tuple[_Task, Any]:
        """The task in work and its result; replaces the worker when it died or has done its share."""
        try:
            result = pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            self.process.join(timeout=5)
            result = WorkerDeathError(
                f"the worker process ended with exit code {self.process.exitcode} "
                "(negative: killed by that signal, -9 often means out of memory)"
            )
        task, self.task = self.task, None
        self.jobs_done += 1
        if isinstance(result, WorkerDeathError) or self.jobs_done >= jobs_per_worker:
            self.stop()
        return task, result

    def dismiss(self) -> None:
        """Tell the worker to end; an idle one leaves by itself when it finds the connection closed."""
        if self.process is not None:
            self.connection.close()
            if self.task is not None:
                self.process.terminate()

    def stop(self) -> None:
        """End the worker and wait for it."""
        if self.process is None:
            return
        self.dismiss()
        self.process.join(timeout=5)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process, self.connection, self.task, self.jobs_done = None, None, None, 0

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        with _running_on(self.cores):
            self.process.start()
        theirs.close()


def _stop(slots: list[_Slot]) -> None:
    """Tell all first, so that they end at the same time."""
    for slot in slots:
        slot.dismiss()
    for slot in slots:
        slot.stop()


def _ready(slots: list[_Slot]) -> list[_Slot]:
    """The busy slots that have an answer or a dead worker; waits for the first."""
    closed = [s for s in slots if s.connection.closed]
    ready = wait([s.connection for s in slots if not s.connection.closed]) if not closed else []
    return closed + [s for s in slots if s.connection in ready]


def _serve(connection: Connection) -> None:
    """A worker's life: take (job, item), answer with the result, until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; only the parent decides
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # unwinds, so that temporary files are removed
    while True:
        try:
            message = connection.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            job, item = pickle.loads(message)
            answer = pickle.dumps(job(item))
        except Exception as error:
            answer = _pickled_error(error)
        try:
            connection.send_bytes(answer)
        except OSError:
            return


def _pickled_error(error: Exception) -> bytes:
    trace = traceback.format_exc()
    error.add_note(trace)
    try:
        answer = pickle.dumps(error)
        pickle.loads(answer)
        return answer
    except Exception:  # an exception whose constructor pickle cannot repeat
        plain = RuntimeError(f"{type(error).__name__}: {error}")
        plain.add_note(trace)
        return pickle.dumps(plain)


def _available_cores() -> list[int]:
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _share(cores: list[int], index: int, count: int) -> frozenset[int]:
    """The cores of worker `index` of `count`: equal runs, or one core for several workers when there are too few."""
    if count >= len(cores):
        return frozenset({cores[index % len(cores)]})
    return frozenset(cores[index * len(cores) // count : (index + 1) * len(cores) // count])


@contextmanager
def _running_on(cores: frozenset[int]) -> Iterator[None]:
    """Within this block new processes inherit `cores`; systems without CPU pinning ignore it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

"""One pinned worker process, fed through a pipe."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import psutil

from rfpp.child_signals import blocked_in_children


class WorkerDeathError(RuntimeError):
    """A worker process died during a job (crash or out of memory)."""


class WorkerHangError(RuntimeError):
    """A job exceeded its time limit, and its worker was killed."""


@dataclass(frozen=True)
class Limits:
    """Limits of a worker: number of jobs, memory growth since its first job in MB, seconds per job."""

    jobs: int
    growth_mb: float | int
    seconds: float | int


@dataclass(frozen=True)
class Task:
    """An item and the number of its attempt."""

    item: Any
    attempt: int = 1


@dataclass
class Slot:
    """A place for one worker process on fixed cores."""

    cores: frozenset[int]
    task: Task | None = None
    began: float = 0.0
    jobs_done: int = 0
    first_memory: int = 0
    process: Any = field(default=None, repr=False)
    connection: Connection | None = field(default=None, repr=False)

    def begin(self, job: Callable, task: Task) -> None:
        if self.process is None:
            self._start()
        self.task, self.began = task, time.monotonic()
        message = pickle.dumps((job, task.item))
        try:
            self.connection.send_bytes(message)
        except OSError:  # the idle worker was killed: `finish` will find it dead and the item is tried again
            self.connection.close()

    def finish(self, limits: Limits) -> tuple[Task, Any]:
        """Return the current task and its result; replace the worker if it died, hangs or has reached its limits."""
        if self.connection.closed or self.connection.poll():
            result = self._received()
        else:
            self.process.kill()
            result = WorkerHangError(f"not finished after {limits.seconds:g} s: its worker was killed")
        task, self.task = self.task, None
        if isinstance(result, WorkerDeathError | WorkerHangError) or self._has_done_its_share(limits):
            self.stop()
        return task, result

    def _received(self) -> Any:
        try:
            return pickle.loads(self.connection.recv_bytes())
        except (EOFError, OSError):
            self.process.join(timeout=5)
            return WorkerDeathError(
                f"the worker process ended with exit code {self.process.exitcode} "
                "(negative: killed by that signal, -9 often means out of memory)"
            )

    def _has_done_its_share(self, limits: Limits) -> bool:
        self.jobs_done += 1
        try:
            memory = psutil.Process(self.process.pid).memory_info().rss
        except psutil.NoSuchProcess:  # it died after its answer; the next job would find out
            return True
        self.first_memory = self.first_memory or memory
        return self.jobs_done >= limits.jobs or memory - self.first_memory > limits.growth_mb * 1e6

    def dismiss(self) -> None:
        """Ask the worker to exit; an idle worker exits when the connection closes."""
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
        self.process, self.connection, self.task, self.jobs_done, self.first_memory = None, None, None, 0, 0

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        with _running_on(self.cores), blocked_in_children():  # only the first process decides on Ctrl-C
            process = context.Process(target=_serve, args=(theirs,), daemon=True)
            process.start()
            self.process = process
        theirs.close()


#: Seconds that a worker may take to leave.
_UNWINDING = 10


def _serve(connection: Connection) -> None:
    """Worker loop: receive (job, item), send the result, until the connection closes."""
    signal.signal(signal.SIGTERM, _leave)
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


def _leave(*_: object) -> None:
    """Exit silently, with stack unwinding, so that temporary files are removed.

    Blender, torn down in the middle of a picture, complains of every block of memory. A second SIGTERM would interrupt
    the unwinding, and what waits for threads there would wait for ever; what takes too long is ended, as nobody else
    may be left to do it.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.alarm(_UNWINDING)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    sys.exit(1)


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


@contextmanager
def _running_on(cores: frozenset[int]) -> Iterator[None]:
    """Let new processes inherit `cores` within this block; systems without CPU pinning ignore it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

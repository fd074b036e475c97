"""Run a measurement in a separate process with time and memory limits."""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TypeVar

import psutil
import torch

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.benchmark.memory import peak_resident

Result = TypeVar("Result")

GB = 1e9
#: What the machine keeps for itself where no limit is set.
_RESERVE = 0.5 * GB
#: Fresh processes come from one that has imported everything and computed nothing. Optimizers import `torch._dynamo`
#: when they are first used: later, it would count as their memory.
_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload([__name__, "torch._dynamo"])
#: Seconds between two looks at a process, and until one that has nothing more to do is killed.
_LOOK_EVERY, _LEAVES_WITHIN = 0.05, 5.0


class NotMeasuredError(Exception):
    """A process was ended; the message is the row's status."""


@dataclass(frozen=True)
class Limits:
    """What a measurement may take.

    Attributes:
        seconds: each time.
        memory_gb: resident memory of the process; None: what the machine has left.
    """

    seconds: float | int
    memory_gb: float | int | None


@dataclass(frozen=True)
class Turn:
    """One execution of a task.

    Attributes:
        seconds: of each quantity.
        peak, held: bytes that weights, batch, activations, gradients and moments took at most until now, and what
            of it was there before the first turn.
    """

    seconds: dict[str, float]
    peak: int
    held: int


@dataclass(frozen=True)
class _Failure:
    out_of_memory: bool
    trace: str


def in_fresh_process(function: Callable[[Setting], Result], setting: Setting) -> Result:
    """`function(setting)`, an importable one."""
    with ProcessPoolExecutor(1, mp_context=_PROCESSES) as process:
        return process.submit(function, setting).result()


class MeasuringProcess:
    """A network and a task in a fresh process. Use as a context manager; `ready`, then `turn` any number of times."""

    def __init__(self, network: Untrained, task: Task, case: Case, setting: Setting, limits: Limits) -> None:
        self._limits = limits
        self._connection, theirs = _PROCESSES.Pipe()
        self._process = _PROCESSES.Process(target=_serve, args=(theirs, network, task, case, setting), daemon=True)
        self._process.start()
        theirs.close()

    def __enter__(self) -> MeasuringProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._process.join(_LEAVES_WITHIN)
        self._end()

    def ready(self) -> None:
        """Wait until network and batch are there. Raises NotMeasuredError."""
        self._answer(seconds=float("inf"))

    def turn(self) -> Turn:
        """Do the task once. Raises NotMeasuredError; the process is then of no more use."""
        with suppress(BrokenPipeError):  # ended by the system: the answer, which is none, tells
            self._connection.send("again")
        return self._answer(self._limits.seconds)

    def _answer(self, seconds: float | int) -> Turn | None:
        deadline = time.monotonic() + seconds
        given = self._limits.memory_gb
        most = psutil.virtual_memory().available + self._resident() - _RESERVE if given is None else given * GB
        answered = False
        while not answered:
            answered = self._connection.poll(_LOOK_EVERY)
            if self._resident() > most:
                self._end()
                raise NotMeasuredError("out of memory")
            if not answered and time.monotonic() > deadline:
                self._end()
                raise NotMeasuredError(f"timed out after {seconds:g} s")
        try:
            answer = self._connection.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            if self._process.exitcode == -signal.SIGKILL:  # the system was faster than we
                raise NotMeasuredError("out of memory") from None
            raise RuntimeError(f"a measuring process ended with exit code {self._process.exitcode}") from None
        if isinstance(answer, _Failure):
            if answer.out_of_memory:
                raise NotMeasuredError("out of memory")
            raise RuntimeError(f"a measuring process failed:\n{answer.trace}")
        return answer

    def _end(self) -> None:
        """Its memory is free when this returns."""
        self._process.kill()
        self._process.join()

    def _resident(self) -> int:
        try:
            return psutil.Process(self._process.pid).memory_info().rss
        except psutil.NoSuchProcess:  # the closed connection will tell
            return 0


def _serve(connection: Connection, network: Untrained, task: Task, case: Case, setting: Setting) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; only the parent decides
    try:
        setting.apply()
        memory = _Memory(setting.where)
        made = setting.network(network)
        run = task.prepared(made, case.batch(made.gbuffer_channels, setting.seed).to(setting.where), setting)
        held = memory.now()
        memory.begin()
        connection.send(None)
        while connection.recv():
            seconds = _turn(run, setting)
            connection.send(Turn(seconds, max(memory.peak(), held), held))
    except EOFError:
        pass
    except Exception as error:
        connection.send(_Failure(_is_out_of_memory(error), traceback.format_exc()))


def _turn(run: Callable[[], dict[str, float]], setting: Setting) -> dict[str, float]:
    if setting.where == "cpu":
        return run()
    run()  # fills the allocator's cache
    seconds = run()
    torch.cuda.empty_cache()  # the other network has the device next
    return seconds


def _is_out_of_memory(error: Exception) -> bool:
    return isinstance(error, MemoryError | torch.OutOfMemoryError) or "DefaultCPUAllocator" in str(error)


class _Memory:
    """Bytes beyond what this process held when the meter was made: of CUDA's allocator, or resident."""

    def __init__(self, device: str) -> None:
        self._on_gpu = device == "cuda"
        self._before = 0
        self._before = self.now()

    def now(self) -> int:
        held = torch.cuda.memory_allocated() if self._on_gpu else psutil.Process().memory_info().rss
        return held - self._before

    def begin(self) -> None:
        """Forget the peak until now, where that is possible."""
        if self._on_gpu:
            torch.cuda.reset_peak_memory_stats()

    def peak(self) -> int:
        peak = torch.cuda.max_memory_allocated() if self._on_gpu else peak_resident()
        return peak - self._before

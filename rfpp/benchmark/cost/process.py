"""Run a task in a separate process, so that its peak memory is its own and its failures become rows."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import sys
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import psutil
import torch

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.training.blocks import compile_blocks

#: Seed of the synthetic scenes.
SEED = 0

#: Memory that is left to the rest of the machine, bytes.
_RESERVE = 5e8
#: Seconds between two checks of a process, and seconds until an idle one is killed.
_POLL_SECONDS, _EXIT_SECONDS = 0.05, 5.0
#: Processes are forked from a server that has imported everything and computed nothing. Optimizers import
#: `torch._dynamo` when they are first used; preloaded, it does not count as their memory.
_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload([__name__, "torch._dynamo"])


class NotMeasuredError(Exception):
    """Failure of a measurement; the message is the row's status."""


@dataclass(frozen=True)
class Turn:
    """One execution of a task."""

    seconds: dict[str, float]
    peak: int
    held: int


class Worker:
    """Process that holds a network and a task. Call `ready` once, then `turn` any number of times."""

    def __init__(
        self, network: Untrained, task: Task, case: Case, compiled: bool, setting: Setting, timeout: float | int
    ) -> None:
        self._timeout = timeout
        self._pipe, theirs = _PROCESSES.Pipe()
        arguments = (theirs, network, task, case, compiled, setting, torch.get_num_threads())
        self._process = _PROCESSES.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._pipe.close()
        self._process.join(_EXIT_SECONDS)
        self._kill()

    def ready(self) -> None:
        """Wait until network and batch are on the device. Raises NotMeasuredError."""
        self._receive(float("inf"))

    def turn(self) -> Turn:
        """Execute the task once. Raises NotMeasuredError, after which the process is unusable."""
        with suppress(BrokenPipeError):  # the process was killed, as `_receive` will find
            self._pipe.send("turn")
        return self._receive(self._timeout)

    def _receive(self, timeout: float | int) -> Turn | None:
        deadline = time.monotonic() + timeout
        limit = self._resident() + psutil.virtual_memory().available - _RESERVE
        received = False
        while not received:
            received = self._pipe.poll(_POLL_SECONDS)
            if self._resident() > limit:
                self._kill()
                raise NotMeasuredError("out of memory")
            if not received and time.monotonic() > deadline:
                self._kill()
                raise NotMeasuredError(f"timed out after {timeout:g} s")
        try:
            message = self._pipe.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            if self._process.exitcode == -signal.SIGKILL:  # by the system, which ran out of memory
                raise NotMeasuredError("out of memory") from None
            raise RuntimeError(f"a measuring process exited with code {self._process.exitcode}") from None
        if isinstance(message, Exception):
            raise message
        return message

    def _kill(self) -> None:
        """Kill the process and wait until its memory is free."""
        self._process.kill()
        self._process.join()

    def _resident(self) -> int:
        try:
            return psutil.Process(self._process.pid).memory_info().rss
        except psutil.NoSuchProcess:  # the closed pipe will report it
            return 0


def _serve(
    pipe: Connection, network: Untrained, task: Task, case: Case, compiled: bool, setting: Setting, threads: int
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the parent decides
    try:
        torch.set_num_threads(threads)
        setting.apply()
        on_gpu = setting.where == "cuda"
        before = _allocated(on_gpu)
        made = network(setting.where)
        if compiled:
            compile_blocks(made)
        batch = case.batch(made.gbuffer_channels, SEED).to(setting.where)
        run = task.prepare(network.name, made, batch, setting)
        held = _allocated(on_gpu) - before
        if on_gpu:
            torch.cuda.reset_peak_memory_stats()
        pipe.send(None)
        while pipe.recv():
            if on_gpu:
                run()  # refills the allocator's cache
            seconds = run()
            if on_gpu:
                torch.cuda.empty_cache()  # the other network uses the device next
            pipe.send(Turn(seconds, max(_peak(on_gpu) - before, held), held))
    except EOFError:
        pass
    except Exception as error:
        out_of_memory = isinstance(error, MemoryError | torch.OutOfMemoryError) or "DefaultCPUAllocator" in str(error)
        failure = RuntimeError(f"a measuring process failed:\n{traceback.format_exc()}")
        pipe.send(NotMeasuredError("out of memory") if out_of_memory else failure)


def _allocated(on_gpu: bool) -> int:
    return torch.cuda.memory_allocated() if on_gpu else psutil.Process().memory_info().rss


def _peak(on_gpu: bool) -> int:
    if on_gpu:
        return torch.cuda.max_memory_allocated()
    status = Path("/proc/self/status")
    if status.exists():  # Linux, where getrusage may return the peak of the parent
        [line] = (line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

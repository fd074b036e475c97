"""Being told to stop: signals set a flag, and all ranks act on it together."""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children, resource_tracker
from pathlib import Path
from types import FrameType
from typing import NoReturn

import torch
from lightning.pytorch.strategies import Strategy

from rfpp.errors import UserError

#: What Slurm is asked to send before the time limit (launch/slurm/train.sbatch): save, and come back.
COME_BACK = signal.SIGUSR1
#: What `scancel`, `kill` and a machine that shuts down send: save, and end.
END = signal.SIGTERM


class StoppedError(UserError):
    """Training ended before its time, on all ranks at once, and everything is saved.

    Attributes:
        signal: what was received.
    """

    def __init__(self, message: str, received: signal.Signals):
        super().__init__(message)
        self.signal = received


@contextmanager
def unheard_by_children() -> Iterator[None]:
    """Daemonic processes started meanwhile never get these signals, which Slurm sends to all of a job's processes.

    A loader process would die of them, and training with it, before the ranks have agreed and saved. When this
    process ends, it kills those that are left.
    """
    stop = {COME_BACK, END}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, stop)
    try:
        resource_tracker.ensure_running()  # multiprocessing's own child; when it starts, it unblocks SIGTERM
        signal.pthread_sigmask(signal.SIG_BLOCK, stop)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        # to run before what multiprocessing and PyTorch do at the end, which is SIGTERM, and to wait
        atexit.unregister(_kill_children)
        atexit.register(_kill_children)


def _kill_children() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # PyTorch's handler raises for loader processes that are killed
    for child in active_children():
        if child.daemon:
            child.kill()


class StopSignals:
    """Remembers that a signal came.

    Nothing is done inside the handler: ranks get a signal at different moments, and one that starts to save in the
    middle of another's all-reduce waits for ever.
    """

    def __init__(self) -> None:
        self._received = 0

    def watch(self) -> None:
        """From now on; replaces Lightning's handlers, which save and communicate inside."""
        for number in (COME_BACK, END):
            signal.signal(number, self._remember)

    def _remember(self, number: int, _: FrameType | None) -> None:
        self._received = number

    def agreed(self, strategy: Strategy) -> signal.Signals | None:
        """What any rank has received, the same answer on all of them; each must ask."""
        number = torch.tensor(self._received, device=strategy.root_device)
        highest = int(strategy.reduce(number, reduce_op="max"))  # SIGTERM's number is above SIGUSR1's
        return signal.Signals(highest) if highest else None


def end_early(stop: StoppedError, run_dir: Path) -> NoReturn:
    """Ask Slurm to start the job again where that was wanted, say how to go on, and exit as a signal's receiver."""
    how = f"the same command with run_dir={run_dir} goes on"
    job = os.environ.get("SLURM_JOB_ID")
    if stop.signal == COME_BACK and job is not None:
        asked = subprocess.run(["scontrol", "requeue", job], capture_output=True, text=True, check=False)
        how = f"job {job} is requeued" if asked.returncode == 0 else f"{asked.stderr.strip()}; {how}"
    print(f"{stop}: {how}", file=sys.stderr, flush=True)
    sys.exit(128 + stop.signal)

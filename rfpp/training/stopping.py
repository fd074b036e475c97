"""Stop training on a signal (rfpp/training/signals.py), on all ranks at the same step."""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path
from typing import NoReturn

import torch
import torch.distributed as dist

from rfpp.child_signals import unheard_by_children
from rfpp.errors import UserError
from rfpp.training.signals import BY_WEIGHT, COME_BACK


class StoppedError(UserError):
    """Training was stopped early, on all ranks at the same step, after saving a checkpoint.

    Attributes:
        signal: what was received.
    """

    def __init__(self, message: str, received: signal.Signals):
        super().__init__(message)
        self.signal = received


@contextmanager
def unheard_by_loaders() -> Iterator[None]:
    """Daemonic children started in this block ignore stop signals, which Slurm and terminals send to all processes.

    A loader process would die of them, and training with it, before the ranks have agreed and saved. When this
    process ends, it kills those that are left.
    """
    try:
        with unheard_by_children(BY_WEIGHT):
            yield
    finally:
        # to run before what multiprocessing and PyTorch do at the end, which is SIGTERM, and to wait
        atexit.unregister(_kill_children)
        atexit.register(_kill_children)


def _kill_children() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # PyTorch's handler raises for loader processes that are killed
    for child in active_children():
        if child.daemon:
            child.kill()


class Agreement:
    """Agreement of all ranks on the received signal and on whether a checkpoint is due.

    Ranks ask over a group of their own, of their processors: an answer that went through their accelerators would
    come after all the work that these have been given. To be made by all ranks together.

    Args:
        ranks: how many there are; one agrees with itself.
    """

    def __init__(self, ranks: int):
        self._group = dist.new_group(backend="gloo") if ranks > 1 else None

    def __call__(self, received: signal.Signals | None, due: bool) -> tuple[signal.Signals | None, bool]:
        """The most important signal of any rank, and whether any rank is due; call on all ranks at the same steps.

        Args:
            received: by this rank.
            due: whether a checkpoint is, in this rank's opinion.
        """
        if self._group is None:
            return received, due
        said = torch.tensor([0 if received is None else 1 + BY_WEIGHT.index(received), int(due)])
        dist.all_reduce(said, dist.ReduceOp.MAX, group=self._group)
        weight, any_due = said.tolist()
        return (BY_WEIGHT[weight - 1] if weight else None), bool(any_due)


def end_early(stop: StoppedError, run_dir: Path) -> NoReturn:
    """Requeue the Slurm job if requested, print how to resume, and exit with the signal's status."""
    how = f"the same command with run_dir={run_dir} goes on"
    job = os.environ.get("SLURM_JOB_ID")
    if stop.signal == COME_BACK and job is not None:
        asked = subprocess.run(["scontrol", "requeue", job], capture_output=True, text=True, check=False)
        requeued = asked.returncode <= 0  # below 0: it was heard, and killed with all of the job before it said so
        how = f"job {job} is requeued" if requeued else f"{asked.stderr.strip()}; {how}"
    print(f"{stop}: {how}", file=sys.stderr, flush=True)
    sys.exit(128 + stop.signal)

"""Stop a training run early, on all ranks at the same step."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import torch
import torch.distributed as dist

from rfpp.errors import UserError
from rfpp.training.signals import BY_PRIORITY, REQUEUE


class StoppedError(UserError):
    """A signal stopped training after a checkpoint was saved; raised on all ranks at the same step."""

    def __init__(self, message: str, received: signal.Signals):
        super().__init__(message)
        self.signal = received


class Agreement:
    """Agreement of all ranks on whether to stop and whether to save.

    Ranks communicate over a gloo group of their own: a collective operation on GPUs would wait for all queued work.
    All ranks must construct it together.
    """

    def __init__(self, ranks: int):
        self._group = dist.new_group(backend="gloo") if ranks > 1 else None

    def __call__(self, received: signal.Signals | None, due: bool) -> tuple[signal.Signals | None, bool]:
        """Return the signal of highest priority over all ranks, and whether a checkpoint is due on any rank.

        All ranks must call it at the same steps.
        """
        if self._group is None:
            return received, due
        request = torch.tensor([0 if received is None else 1 + BY_PRIORITY.index(received), int(due)])
        dist.all_reduce(request, dist.ReduceOp.MAX, group=self._group)
        priority, any_due = request.tolist()
        return (BY_PRIORITY[priority - 1] if priority else None), bool(any_due)


def exit_early(stop: StoppedError, run_dir: Path) -> NoReturn:
    """Requeue the Slurm job if requested, print how to resume, and exit with the signal's status."""
    advice = f"resume with the same command and run_dir={run_dir}"
    job = os.environ.get("SLURM_JOB_ID")
    if stop.signal == REQUEUE and job is not None:
        requeue = subprocess.run(["scontrol", "requeue", job], capture_output=True, text=True, check=False)
        succeeded = requeue.returncode <= 0  # negative: Slurm requeued the job and killed scontrol with it
        advice = f"job {job} is requeued" if succeeded else f"{requeue.stderr.strip()}; {advice}"
    print(f"{stop}: {advice}", file=sys.stderr, flush=True)
    sys.exit(128 + stop.signal)

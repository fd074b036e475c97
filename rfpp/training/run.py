"""Folder, lock and Trainer plugins of a training run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from lightning.pytorch.plugins.environments import SLURMEnvironment
from torch import nn

from rfpp.errors import UserError
from rfpp.training.checkpoint_files import BackgroundCheckpointIO


class RunningError(UserError):
    """Another process is training in the folder."""


def trainer_plugins() -> list[Any]:
    """Return the Trainer's plugins.

    Checkpoints are written in the background. Lightning's requeueing is disabled: it saves inside the signal handler.
    """
    slurm = [SLURMEnvironment(auto_requeue=False)] if SLURMEnvironment.detect() else []
    return [BackgroundCheckpointIO(), *slurm]


@contextmanager
def locked(run_dir: Path) -> Iterator[None]:
    """Lock a run's folder. The operating system releases the lock of a killed process.

    Raises:
        RunningError: If another process holds the lock.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    lock = FileLock(run_dir / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise RunningError(
            f"{run_dir}: another process is training this run: wait until it has finished, or choose another run_dir"
        ) from error
    except NotImplementedError:  # the file system has no locks
        yield
        return
    try:
        yield
    finally:
        lock.release()


def parameter_counts(network: nn.Module) -> dict[str, int]:
    """Return the number of parameters of each stage, in order, and in total."""
    counts = {name: sum(p.numel() for p in part.parameters()) for name, part in network.named_children()}
    return {**counts, "total": sum(counts.values())}

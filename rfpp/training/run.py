"""Trainer, folder and lock of a training run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
from filelock import FileLock, Timeout
from hydra.utils import instantiate
from lightning.pytorch.plugins.environments import SLURMEnvironment
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from omegaconf import DictConfig, OmegaConf
from torch import nn

from rfpp.errors import UserError
from rfpp.training.checkpoint_files import BackgroundCheckpointIO

#: Settings of where a run writes.
_FOLDERS = ("callbacks.best.dirpath", "callbacks.checkpoints.folder", "callbacks.divergence.run_dir",
            "callbacks.finite_gradients.folder", "callbacks.panels.folder", "logger.run_dir")  # fmt: skip


class RunningError(UserError):
    """Another process is training in the folder."""


def folder_of(cfg: DictConfig) -> Path:
    """Return the folder of a run.

    Raises:
        UserError: Naming a setting that would write outside it, where nothing looks for a run's files.
    """
    folder = Path(cfg.run_dir).absolute()
    for key in _FOLDERS:
        path = OmegaConf.select(cfg, key)
        if path is not None and not Path(path).absolute().is_relative_to(folder):
            raise UserError(f"{key}={path}: is not in {folder}: set run_dir alone")
    return Path(cfg.run_dir)


def trainer_plugins() -> list[Any]:
    """Return the Trainer's plugins.

    Checkpoints are written in the background. Lightning's requeueing is disabled: it saves inside the signal handler.
    """
    slurm = [SLURMEnvironment(auto_requeue=False)] if SLURMEnvironment.detect() else []
    return [BackgroundCheckpointIO(), *slurm]


def build_trainer(settings: DictConfig, **arguments: Any) -> L.Trainer:
    """Build the Trainer of conf/trainer with further arguments.

    Raises:
        UserError: If Lightning refuses a setting.
    """
    build = instantiate(settings, _partial_=True)  # Hydra would treat the logger as a configuration
    try:
        return build(**arguments)
    except (MisconfigurationException, TypeError, ValueError) as error:
        raise UserError(f"trainer: {' '.join(str(error).split())}") from error


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

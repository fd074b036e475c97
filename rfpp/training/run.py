"""A training run's folder and start summary."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.plugins.environments import SLURMEnvironment
from omegaconf import DictConfig
from torch import nn

from rfpp.training.checkpoint_files import AtomicCheckpointIO
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.tracking.run_logger import RunLogger

#: Environment variable with the name of the run's folder, where it is not the time of starting (conf/common.yaml).
RUN_VARIABLE = "RFPP_RUN"


def divide_global_batch(trainer: L.Trainer, datamodule: SceneDataModule) -> None:
    """Make every step of the trainer one global batch, whatever the number of devices.

    Lightning counts batches between validations, the configuration optimizer steps; a run shorter than that validates
    at its end.

    Raises:
        UserError: the global batch does not divide among the devices.
    """
    trainer.accumulate_grad_batches = datamodule.accumulation(trainer.world_size)
    if not trainer.fast_dev_run:
        trainer.val_check_interval = (
            min(trainer.val_check_interval, trainer.max_steps) * trainer.accumulate_grad_batches
        )


def trainer_plugins() -> list[Any]:
    """Atomic checkpoints; under Slurm, disable Lightning's requeueing, which saves inside the signal handler."""
    slurm = [SLURMEnvironment(auto_requeue=False)] if SLURMEnvironment.detect() else []
    return [AtomicCheckpointIO(), *slurm]


@contextmanager
def same_folder_in_children(run_dir: Path) -> Iterator[None]:
    """Make child processes (one per further device), which recompose the configuration, use this folder."""
    os.environ[RUN_VARIABLE] = run_dir.name
    try:
        yield
    finally:
        del os.environ[RUN_VARIABLE]


def parameter_counts(network: nn.Module) -> dict[str, int]:
    """Parameter counts per stage, in order, and in total."""
    counts = {name: sum(p.numel() for p in part.parameters()) for name, part in network.named_children()}
    return {**counts, "total": sum(counts.values())}


def start_summary(cfg: DictConfig, network: nn.Module, datamodule: SceneDataModule, trainer: L.Trainer) -> str:
    """Summary at the start: network by stage, data, batches, devices, precision, output folders."""
    counts = parameter_counts(network)
    stages = ", ".join(f"{name} {count / 1e6:.2f}M" for name, count in counts.items() if name != "total")
    data = datamodule.manifest
    images = datamodule.batching.scenes_per_step * datamodule.batching.views_per_scene
    share = datamodule.batching.scenes_per_step // trainer.world_size
    at_once = share // trainer.accumulate_grad_batches
    logger = trainer.logger
    writes = f"{cfg.run_dir}, {logger.kept}" if isinstance(logger, RunLogger) else "nothing: a trial"
    return (
        f"Network  {counts['total'] / 1e6:.1f}M parameters: {stages}\n"
        f"Data     {data.root}: {data.counts['scenes']} scenes, {data.counts['images']} images "
        f"of {cfg.data.resolution}² (manifest {data.hash[:12]})\n"
        f"Steps    {cfg.steps} of {datamodule.batching.scenes_per_step} scenes x {datamodule.batching.views_per_scene} "
        f"views = {images} images\n"
        f"Devices  {trainer.world_size} x {_device_name(trainer)}, {share} scenes each, {at_once} at a time, "
        f"{cfg.trainer.precision}\n"
        f"Writes   {writes}"
    )


def _device_name(trainer: L.Trainer) -> str:
    device = trainer.strategy.root_device
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"CPU (threads: {torch.get_num_threads()})" if device.type == "cpu" else device.type

"""A training run's folder, and what is said when it starts."""

from __future__ import annotations

import os
from pathlib import Path

from omegaconf import DictConfig, OmegaConf
from torch import nn

from rfpp.scene.files import write_atomically
from rfpp.training.datamodule import SceneDataModule


def write_config(cfg: DictConfig, folder: Path, name: str = "config.yaml") -> Path:
    """Write the config with every value resolved into `folder`, atomically; returns the file's path."""
    return write_atomically(folder / name, OmegaConf.to_yaml(cfg, resolve=True).encode())


def point_latest_at(run_dir: Path) -> None:
    """Make `latest` beside the run's folder a link to it, so that other commands can name the newest run."""
    link = run_dir.parent / "latest"
    temporary = run_dir.parent / f".latest-{os.getpid()}"
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(run_dir.name)
    os.replace(temporary, link)


def parameter_counts(network: nn.Module) -> dict[str, int]:
    """Parameters of each stage, in order, and in all."""
    counts = {name: sum(p.numel() for p in part.parameters()) for name, part in network.named_children()}
    return {**counts, "total": sum(counts.values())}


def start_summary(cfg: DictConfig, network: nn.Module, datamodule: SceneDataModule) -> str:
    """A few lines: network by stage, data, batch arithmetic, precision, where things are written."""
    counts = parameter_counts(network)
    stages = ", ".join(f"{name} {count / 1e6:.2f}M" for name, count in counts.items() if name != "total")
    data = datamodule.manifest
    batch = f"{datamodule.scenes_per_step} scenes x {datamodule.views_per_scene} views"
    return (
        f"Network  {counts['total'] / 1e6:.1f}M parameters: {stages}\n"
        f"Data     {data.root}: {data.counts['scenes']} scenes, {data.counts['images']} images "
        f"of {cfg.data.resolution}² (manifest {data.hash[:12]})\n"
        f"Steps    {cfg.steps} of {batch}, {cfg.trainer.precision}\n"
        f"Writes   {cfg.run_dir}"
    )

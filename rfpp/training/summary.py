"""Text printed when training starts and ends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from rfpp.metrics.image import METRICS
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.plan import TrainingPlan
from rfpp.training.run import parameter_counts
from rfpp.training.tracking.description import hardware
from rfpp.training.tracking.journal import JOURNAL, records
from rfpp.training.tracking.run_logger import RunLogger


def start_summary(
    cfg: Mapping[str, Any],
    plan: TrainingPlan,
    network: nn.Module,
    datamodule: SceneDataModule,
    logger: RunLogger,
    device: torch.device,
) -> str:
    """Summarize network, data, batches, devices, precision and output folders."""
    counts = parameter_counts(network)
    stages = ", ".join(f"{name} {count / 1e6:.2f}M" for name, count in counts.items() if name != "total")
    data = datamodule.manifest
    scenes, views = datamodule.batching.scenes_per_step, datamodule.batching.views_per_scene
    share = scenes // plan.ranks
    return (
        f"Network  {counts['total'] / 1e6:.1f}M parameters: {stages}\n"
        f"Data     {data.root}: {data.counts['scenes']} scenes, {data.counts['images']} images "
        f"of {cfg['data']['resolution']}² (manifest {data.hash[:12]})\n"
        f"Steps    {cfg['steps']} of {scenes} scenes x {views} views = {scenes * views} images\n"
        f"Devices  {plan.ranks} x {hardware(device)}, {share} scenes each, {share // plan.accumulate_grad_batches} "
        f"at a time, {plan.precision}\n"
        f"Writes   {logger.run_dir}, {logger.location}"
    )


def end_summary(logger: RunLogger, checkpoint: Path, data_root: str, monitor: str | None) -> str:
    """Summarize the best validation, its checkpoint, the logs, and the commands to evaluate and render.

    Args:
        monitor: Metric that selects the best checkpoint, the lower the better; None if none does.
    """
    validations = [
        record
        for record, _ in records(logger.run_dir / JOURNAL)
        if record["kind"] == "metrics" and monitor in record["values"]
    ]
    lines = []
    if validations:
        best = min(validations, key=lambda record: record["values"][monitor])
        scores = ", ".join(
            f"{metric.label} {best['values'][f'validation/{name}']:.{metric.decimals}f}"
            for name, metric in METRICS.items()
            if f"validation/{name}" in best["values"]
        )
        lines.append(f"Best     step {best['step'] + 1}: {scores}")
    lines += [
        f"Written  {checkpoint}, {logger.location}",
        f"Evaluate python launch/evaluate.py data.root={data_root} checkpoint={checkpoint}",
        f"Render   python launch/render.py scene=data/scenes/cornell_box.json checkpoint={checkpoint}",
    ]
    return "\n".join(lines)

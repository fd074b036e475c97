"""Inspect a trained transport operator: residuals and images after each application.

python launch/inspect_transport.py experiment=quickstart checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console

from rfpp.checkpoint.loading import load_network
from rfpp.commands import entry_point, required
from rfpp.evaluation.measuring.transport_convergence import trace_transport
from rfpp.evaluation.report.transport_report import write_transport_report
from rfpp.progress import progress_bars
from rfpp.shards.dataset import ShardSplit


@entry_point("inspect_transport")
def main(cfg: DictConfig) -> Path:
    """Trace `cfg.checkpoint` on `cfg.split`; returns the report's page."""
    console = Console(highlight=False, soft_wrap=True)
    network, info = load_network(required(cfg, "checkpoint"))
    device = torch.device(cfg.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    output = Path(cfg.output) if cfg.output else Path(cfg.checkpoint).parents[1] / "transport"
    split = ShardSplit(cfg.data.root, cfg.split, instantiate(cfg.datamodule.source.cache))
    with progress_bars(console) as bar:
        network.to(device)
        trace = trace_transport(
            network, split, cfg.applications, cfg.pictured_scenes, device, bar("scenes", len(split))
        )
    title = f"{len(split)} scenes of {cfg.data.root}, split {cfg.split}"
    *_, page = write_transport_report(trace, info, title, output)
    console.print(f"Report: {page}")
    return page


if __name__ == "__main__":
    main()

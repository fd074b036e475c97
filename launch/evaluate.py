"""Measure a trained network on stored scenes, beside the trivial baselines.

    python launch/evaluate.py +experiment=quickstart checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
"""

from __future__ import annotations

from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from rfpp.entry import entry_point
from rfpp.errors import UserError
from rfpp.evaluation.evaluate import fitted_baselines, evaluate_split, ranked_scenes, render_stored
from rfpp.evaluation.panels import save_scene_panel
from rfpp.evaluation.tables import ImageRecord, results_table, split_means, write_csv
from rfpp.evaluation.tracking import log_evaluation
from rfpp.inference.checkpoint import load_network
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS
from rfpp.shards.stream import ShardSplit


@entry_point("evaluate")
def main(cfg: DictConfig) -> dict[tuple[str, str], dict[str, float]]:
    """Evaluate `cfg.checkpoint` on the splits of `cfg.data`; returns the means by (split, predictor)."""

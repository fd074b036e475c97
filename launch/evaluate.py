"""Measure a trained network on stored scenes, beside the trivial baselines.

python launch/evaluate.py +experiment=quickstart checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
"""

from __future__ import annotations

from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from rfpp.entry import entry_point
from rfpp.errors import UserError
from rfpp.evaluation.evaluate import evaluate_split, fitted_baselines, ranked_scenes, render_stored
from rfpp.evaluation.panels import save_scene_panel
from rfpp.evaluation.results import log_to_training_run
from rfpp.evaluation.tables import results_table, split_means, write_csv
from rfpp.inference.checkpoint import load_network
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS
from rfpp.shards.stream import ShardSplit
from rfpp.training.run import write_config


@entry_point("evaluate")
def main(cfg: DictConfig) -> dict[tuple[str, str], dict[str, float]]:
    """Evaluate `cfg.checkpoint` on `cfg.evaluation.splits`; returns the mean metrics by (split, predictor)."""
    console = Console(highlight=False)
    if OmegaConf.is_missing(cfg, "checkpoint"):
        raise UserError("checkpoint is not given: add checkpoint=<run folder>/checkpoints/best.ckpt")
    device = torch.device(cfg.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    network, info = load_network(cfg.checkpoint)
    network.to(device)
    output = Path(cfg.output) if cfg.output else Path(cfg.checkpoint).parents[1] / "evaluation"

    splits = [ShardSplit(cfg.data.root, name) for name in cfg.evaluation.splits]
    if info.data_manifest != splits[0].manifest.hash:
        console.print(f"Note: {cfg.checkpoint} was trained on another data set than {cfg.data.root}.", style="yellow")
    metrics = ImageMetrics(LPIPS.pretrained(cfg.loss.lpips_trunk_path) if cfg.evaluation.lpips else None)
    baselines = fitted_baselines(ShardSplit(cfg.data.root, "train"), cfg.evaluation.baseline_scenes)

    records, panels = [], []
    with _bar(console) as bar:
        for split in splits:
            task = bar.add_task(split.split, total=len(split))
            mine = evaluate_split(network, split, baselines, metrics, device, lambda task=task: bar.advance(task))
            chosen = ranked_scenes(mine)
            scenes = {caption: render_stored(network, split, index, device) for caption, index in chosen.items()}
            panels.append(save_scene_panel(scenes, output / f"{split.split}.png"))
            records += mine

    means = split_means(records)
    files = [*write_csv(records, output), *panels, write_config(cfg, output)]
    console.print(results_table(means))
    console.print(f"Per image, per scene, summary and panels: {output}", soft_wrap=True)
    console.print(log_to_training_run(info, means, files), soft_wrap=True)
    return means


def _bar(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console)


if __name__ == "__main__":
    main()

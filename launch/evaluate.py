"""Measure trained networks on stored scenes, beside the trivial baselines.

python launch/evaluate.py experiment=quickstart checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
python launch/evaluate.py experiment=quickstart checkpoint=[a/checkpoints/best.ckpt,b/checkpoints/best.ckpt]
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from collections.abc import Sequence
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rfpp.model.radiosity import UnlearnedRadiosity
from rich.console import Console

from rfpp.checkpoint.loading import load_network
from rfpp.commands import entry_point
from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import bucketed
from rfpp.evaluation.measuring.confidence import Bootstrap, split_estimates
from rfpp.evaluation.measuring.csv_files import write_buckets, write_records, write_summary
from rfpp.evaluation.measuring.disabled_parts import growth_by_part, growth_text
from rfpp.evaluation.measuring.evaluate import baseline_records, fitted_baselines, network_records, render_stored
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.records import ImageRecord, scene_records
from rfpp.evaluation.measuring.training_cost import TrainingCost
from rfpp.evaluation.report.evaluation_report import write_report
from rfpp.evaluation.report.picture_archive import write_pictures
from rfpp.evaluation.report.ranking import pictured_scenes, ranked_scenes
from rfpp.evaluation.report.scene_panels import first_view, save_scene_panel
from rfpp.evaluation.tables.terminal import results_table
from rfpp.evaluation.tracked_results import log_to_training_run, results_folder, run_folder
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS
from rfpp.progress import progress_bars
from rfpp.shards.dataset import ShardSplit
from rfpp.training.config_file import write_config
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("evaluate")
def main(cfg: DictConfig) -> list[Evaluation]:
    """Evaluate each of `cfg.checkpoint` on `cfg.evaluation.splits`; returns what each scored, in the same order."""
    console = Console(highlight=False)
    if cfg.evaluation.pictured_scenes < 3:
        raise UserError("evaluation.pictured_scenes: give at least 3: the best scene, the median and the worst")
    if OmegaConf.is_missing(cfg, "checkpoint"):
        raise UserError("checkpoint is not given: add checkpoint=<run folder>/checkpoints/best.ckpt")
    given = [cfg.checkpoint] if isinstance(cfg.checkpoint, str) else list(cfg.checkpoint)
    checkpoints = [checkpoint_file(name, cfg.registry.tracking_uri, Path(cfg.registry.folder)) for name in given]
    cache = instantiate(cfg.datamodule.source.cache)
    splits = [ShardSplit(cfg.data.root, name, cache) for name in cfg.evaluation.splits]
    outputs = _outputs(checkpoints, cfg.output, splits[0].manifest.name)
    device = torch.device(cfg.device or ("cuda" if torch.cuda.is_available() else "cpu"))
    lpips = LPIPS.pretrained(cfg.loss.lpips_trunk_path) if cfg.evaluation.lpips else None
    metrics = ImageMetrics(lpips, cfg.evaluation.detailed)
    baselines = fitted_baselines(ShardSplit(cfg.data.root, "train", cache), cfg.evaluation.baseline_scenes)
    beside = []
    radiosity = UnlearnedRadiosity().to(device)
    with progress_bars(console) as bar:
        for split in splits:
            count = bar(f"{split.split}, baselines", len(split))
            beside += baseline_records(baselines, split, metrics, device, count)
            count = bar(f"{split.split}, {radiosity.name}", len(split))
            beside += network_records(radiosity, split, metrics, device, count, predictor=radiosity.name)
    return [_evaluate(cfg, *item, splits, metrics, beside, device, console) for item in outputs.items()]


def _outputs(checkpoints: Sequence[str], chosen: str | None, data: str) -> dict[str, Path]:
    """Checkpoint → folder for its results. Loads every checkpoint first, so that errors show before hours of work."""
    folders = {checkpoint: results_folder(checkpoint, load_network(checkpoint)[1], data) for checkpoint in checkpoints}
    outputs = {checkpoint: Path(chosen or folder) for checkpoint, folder in folders.items()}
    if len(set(outputs.values())) < len(checkpoints):
        raise UserError("checkpoint: two would write to one folder: evaluate each alone, with output=<folder>")
    return outputs


def _evaluate(
    cfg: DictConfig,
    checkpoint: str,
    output: Path,
    splits: Sequence[ShardSplit],
    metrics: ImageMetrics,
    beside: Sequence[ImageRecord],
    device: torch.device,
    console: Console,
) -> Evaluation:
    """Render, measure, write, print and track one checkpoint, with the baselines' records `beside` its own."""
    network, info = load_network(checkpoint)
    network.to(device)
    manifest = splits[0].manifest
    console.print(f"{info.method}, seed {info.seed}: {checkpoint}", style="bold", soft_wrap=True)
    if info.data_manifest != manifest.hash:
        console.print(f"Note: {checkpoint} was trained on another data set than {cfg.data.root}.", style="yellow")

    images, panels, pictures, life = [], [], {}, {}
    with progress_bars(console) as bar:
        for split in splits:
            mine = network_records(network, split, metrics, device, bar(f"{split.split}, model", len(split)))
            life[split.split] = growth_by_part(network, split, device, cfg.evaluation.life_scenes)
            scenes = scene_records(mine)
            shown = pictured_scenes(scenes, cfg.evaluation.pictured_scenes)
            views = {index: first_view(render_stored(network, split, index, device)) for index in shown}
            chosen = {caption: views[index] for caption, index in ranked_scenes(scenes).items()}
            panels.append(save_scene_panel(chosen, output / f"{split.split}.png"))
            pictures |= {(split.split, scenes[index].scene): view for index, view in views.items()}
            images += [*mine, *(record for record in beside if record.split == split.split)]

    scenes, bootstrap = scene_records(images), Bootstrap(**cfg.evaluation.bootstrap)
    means, buckets = split_estimates(scenes, bootstrap), bucketed(scenes, cfg.evaluation.buckets, bootstrap)
    cost = TrainingCost.of_run(run_folder(checkpoint))
    evaluation = Evaluation.of(info, manifest, device, means, cost, life)
    tables = [*write_records(images, scenes, output), write_summary(means, output), write_buckets(buckets, output)]
    files = [*tables, evaluation.write(output), write_pictures(pictures, output), *panels, write_config(cfg, output)]
    report = write_report(output)
    console.print(results_table(means, buckets))
    for split, shares in life.items():
        if shares:
            console.print(f"{split}: {growth_text(shares)}", soft_wrap=True)
    console.print(f"Report: {report}", soft_wrap=True)
    console.print(f"Per image, per scene, summary, buckets and panels: {output}", soft_wrap=True)
    console.print(log_to_training_run(info, evaluation, [*files, report]), soft_wrap=True)
    return evaluation


if __name__ == "__main__":
    main()

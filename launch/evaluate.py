"""Evaluate checkpoints on stored scenes, beside trivial baselines.

python launch/evaluate.py experiment=quickstart checkpoint=data/runs/quickstart/latest/checkpoints/best.ckpt
python launch/evaluate.py experiment=quickstart checkpoint=[data/runs/quickstart/latest/checkpoints/best.ckpt,radiosity]
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
from collections.abc import Sequence
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig, OmegaConf
from rich.console import Console

from rfpp.commands import entry_point, write_config
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Bootstrap, split_estimates
from rfpp.evaluation.measuring.csv_files import write_records
from rfpp.evaluation.measuring.evaluate import score
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.network_checks import ablation_growth, transport_convergence
from rfpp.evaluation.measuring.number_text import ablation_text
from rfpp.evaluation.measuring.predictors import NetworkPredictor, fitted_baselines, predictor_of
from rfpp.evaluation.measuring.records import MODEL, SceneRecord
from rfpp.evaluation.report.evaluation_report import write_report
from rfpp.evaluation.report.pictures import pictured_scenes, save_panel
from rfpp.evaluation.tables.terminal import results_table
from rfpp.evaluation.tracked_results import log_to_training_run, results_folder
from rfpp.inference.devices import available_device
from rfpp.inference.renderer import Renderer
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS, load_trunk
from rfpp.progress import counting
from rfpp.shards.dataset import ShardSplit
from rfpp.training.tracking.registry import checkpoint_file


@entry_point("evaluate")
def main(cfg: DictConfig) -> list[Evaluation]:
    """Evaluate each of `cfg.checkpoint` on `cfg.evaluation.splits`; return the results in the same order."""
    console, device = Console(highlight=False), available_device(cfg.device)
    if OmegaConf.is_missing(cfg, "checkpoint"):
        raise UserError("checkpoint is not given: add checkpoint=<run folder>/checkpoints/best.ckpt")
    given = list(cfg.checkpoint) if isinstance(cfg.checkpoint, ListConfig) else [cfg.checkpoint]
    checkpoints = [checkpoint_file(name, cfg.registry.tracking_uri, Path(cfg.registry.folder)) for name in given]
    cache = instantiate(cfg.datamodule.source.cache)
    splits = [ShardSplit(cfg.data.root, name, cache) for name in cfg.evaluation.splits]
    outputs = _outputs(checkpoints, cfg.output, splits[0].manifest.name)
    lpips = LPIPS(load_trunk()) if cfg.evaluation.lpips else None
    metrics = ImageMetrics(lpips, cfg.evaluation.detailed)
    baselines = fitted_baselines(ShardSplit(cfg.data.root, "train", cache), cfg.evaluation.baseline_scenes)
    records = []
    for split in splits:
        with counting(console, f"scenes of {split.split}, baselines") as (show, _):
            records += score(baselines, split, metrics, device, show)
    return [_evaluate(cfg, *item, splits, metrics, records, device, console) for item in outputs.items()]


def _outputs(checkpoints: Sequence[str], chosen: str | None, data: str) -> dict[str, Path]:
    """Return the folder of each checkpoint's results. Load all checkpoints first, to fail before hours of work."""
    folders = {name: results_folder(name, Renderer.load(name, "cpu").info, data) for name in checkpoints}
    outputs = {name: Path(chosen or folder) for name, folder in folders.items()}
    if len(set(outputs.values())) < len(checkpoints):
        raise UserError("checkpoint: two would write to one folder: evaluate each alone, with output=<folder>")
    return outputs


def _evaluate(
    cfg: DictConfig,
    checkpoint: str,
    output: Path,
    splits: Sequence[ShardSplit],
    metrics: ImageMetrics,
    baselines: Sequence[SceneRecord],
    device: torch.device,
    console: Console,
) -> Evaluation:
    """Score, write, print and track one checkpoint; `baselines` holds the baselines' records."""
    renderer = Renderer.load(checkpoint, device, "fp32")
    predictor, info, manifest = predictor_of(renderer), renderer.info, splits[0].manifest
    console.print(f"{info.method}, seed {info.seed}: {checkpoint}", style="bold", soft_wrap=True)
    if info.data_manifest != manifest.hash:
        console.print(f"Note: {checkpoint} was trained on another data set than {cfg.data.root}.", style="yellow")

    records, pictured, panels = [], [], []
    checks: dict[str, dict] = {"ablation": {}, "transport": {}}
    for split in splits:
        name = split.split
        with counting(console, f"scenes of {name}") as (show, _):
            scored = score([predictor], split, metrics, device, show)
        records += [*scored, *(record for record in baselines if record.split == name)]
        if isinstance(predictor, NetworkPredictor):
            sample = (predictor.network, split, device, cfg.evaluation.ablation_scenes)
            checks["ablation"][name] = ablation_growth(*sample)
            checks["transport"][name] = transport_convergence(*sample)
        shown = pictured_scenes(scored, predictor, split, device)
        panels.append(save_panel(shown, output / f"{name}.png"))
        pictured += shown

    means = split_estimates(records, Bootstrap(**cfg.evaluation.bootstrap))
    evaluation = Evaluation.of(info, manifest, device, means, **checks)
    files = [*write_records(records, means, output), evaluation.write(output), *panels, write_config(cfg, output)]
    report = write_report(evaluation, records, pictured, output)
    console.print(results_table(means))
    for name in (split.split for split in splits):
        error = {who: values["log_l1"].mean for (of, who), values in means.items() if of == name}
        compared = (f"{error[MODEL] / error[who] - 1:+.0%} against {who}" for who in error if who != MODEL)
        console.print(f"{name}: log-L1 {', '.join(compared)}", soft_wrap=True)
        if growth := checks["ablation"].get(name):
            console.print(f"{name}: {ablation_text(growth)}", soft_wrap=True)
    console.print(f"Report: {report}", soft_wrap=True)
    console.print(f"Per image, per scene, summary and panels: {output}", soft_wrap=True)
    console.print(log_to_training_run(info, evaluation, [*files, report]), soft_wrap=True)
    return evaluation


if __name__ == "__main__":
    main()

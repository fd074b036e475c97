"""Train the refinement of radiosity on images that radiosity renders of a data set.

python launch/generate.py experiment=rfpp_real
python launch/refine.py experiment=rfpp_real
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
import logging
import warnings
from pathlib import Path

import lightning as L
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch.utils.data import DataLoader, RandomSampler

from rfpp import Renderer
from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.commands import entry_point, write_config
from rfpp.progress import counting
from rfpp.shards.dataset import ShardSplit
from rfpp.training.callbacks.progress import TrainingProgress
from rfpp.training.plan import choose_precision
from rfpp.training.refining import AugmentedViews, RefinementModule, render_views
from rfpp.training.run import build_trainer
from rfpp.training.tracking import code_version


@entry_point("refine")
def main(cfg: DictConfig) -> Path:
    """Train the refinement of `cfg.radiosity` on `cfg.data`; return the model folder."""
    warnings.filterwarnings("ignore", message=".*(does not have many workers|`srun` command is available).*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    L.seed_everything(cfg.seed, verbose=False)
    console = Console(highlight=False, soft_wrap=True)
    config, plan = OmegaConf.to_container(cfg, resolve=True), cfg.refining
    radiosity, cache = instantiate(cfg.radiosity, _convert_="all"), instantiate(cfg.datamodule.source.cache)
    if plan.initial:
        initial = Renderer.load(plan.initial, "cpu", "fp32").require_linear("refining.initial")
        radiosity.load_state_dict(initial.module.state_dict())
    train, validation = (ShardSplit(cfg.data.root, name, cache) for name in ("train", "validation"))
    info = CheckpointInfo(
        model=config["radiosity"],
        resolution=(plan.default_resolution, plan.default_resolution),
        data_manifest=train.manifest.hash,
        dataset=train.manifest.name,
        method=plan.method,
        seed=cfg.seed,
        steps=plan.steps,
        commit=code_version(),
    )
    renderer, views = Renderer(radiosity, info), []
    for split, scenes in ((train, plan.scenes), (validation, None)):
        with counting(console, f"scenes of {split.split}") as (show, _):
            views.append(render_views(renderer, split, config["refining"]["samplings"], cfg.seed, scenes, show))

    parts = (instantiate(plan[name], _convert_="all") for name in ("loss", "optimizer", "schedule"))
    module = RefinementModule(radiosity.refinement, *parts)
    logger = instantiate(cfg.logger)
    trainer = build_trainer(
        cfg.trainer,
        precision=choose_precision(cfg.trainer.precision, cfg.trainer.accelerator, None),
        max_steps=plan.steps,
        val_check_interval=min(plan.validate_every_n_steps, plan.steps),
        enable_checkpointing=False,
        logger=logger,
        callbacks=[TrainingProgress()],
    )
    tags = {"code_version": info.commit or "unknown", "data_manifest": info.data_manifest}
    logger.describe(config, write_config(config, Path(cfg.run_dir)), train.manifest, tags)
    draws = RandomSampler(views[0], num_samples=plan.steps * plan.images_per_step)
    batches = DataLoader(AugmentedViews(views[0], cfg.seed), plan.images_per_step, sampler=draws)
    trainer.fit(module.train(), batches, DataLoader(views[1], plan.images_per_step))

    before, after = (float(trainer.callback_metrics[f"validation/{name}"]) for name in ("unrefined_log_l1", "log_l1"))
    console.print(f"Validation log-L1 {before:.5f} → {after:.5f} ({after / before - 1:+.1%})")
    folder = Renderer(radiosity.to("cpu", torch.float32), info).save(cfg.output)
    console.print(f"Model: {folder}")
    return folder


if __name__ == "__main__":
    main()

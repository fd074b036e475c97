"""Train a refinement of a network's images, on what it renders of a data set; the network itself stays as it is.

python launch/generate.py experiment=rfpp_real
python launch/refine.py experiment=rfpp_real checkpoint=rfpp-tiny

Images are rendered once and kept, so the same command goes on where it was stopped while rendering.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
import logging
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import lightning as L
import numpy as np
from hydra.utils import instantiate
from lightning.pytorch.loggers import CSVLogger
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch.utils.data import DataLoader, RandomSampler

from rfpp import Renderer
from rfpp.checkpoint.loading import load_network
from rfpp.commands import entry_point
from rfpp.progress import counting
from rfpp.shards.dataset import ShardSplit
from rfpp.training.callbacks.progress_bar import TrainingProgress
from rfpp.training.callbacks.progress_log import TrainingLines
from rfpp.training.config_file import write_config
from rfpp.training.precision import training_precision
from rfpp.training.refining.module import RefinementModule
from rfpp.training.refining.rendered_views import AugmentedViews, RenderedViews
from rfpp.training.tracking.description import code_version

#: What the method of a refined network is called besides.
_REFINED = ", refined"


@entry_point("refine")
def main(cfg: DictConfig) -> Path:
    """Refine `cfg.checkpoint` by `cfg.data`; returns the refined network's folder."""
    console = Console(highlight=False, soft_wrap=True)
    warnings.filterwarnings("ignore", message=".*(does not have many workers|exists and is not empty).*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    L.seed_everything(cfg.seed, verbose=False)
    plan, cache = cfg.refining, instantiate(cfg.datamodule.cache)
    renderer = Renderer.load(cfg.checkpoint, "cpu")
    samplings = [(samples, points) for samples, points in plan.samplings]

    def rendered(split: str) -> RenderedViews:
        stored = ShardSplit(cfg.data.root, split, cache)
        with counting(console, f"scenes of {split}") as (show, _):
            return RenderedViews(renderer, stored, samplings, cfg.seed, Path(plan.rendered), show)

    views, validation = rendered("train"), rendered("validation")
    refinement = instantiate(cfg.refinement, _convert_="all")
    parts = (instantiate(plan[name], _convert_="all") for name in ("loss", "optimizer", "schedule"))
    module = RefinementModule(refinement, *parts)
    trainer = instantiate(
        cfg.trainer,
        precision=training_precision(cfg.trainer.precision, cfg.trainer.accelerator, None),
        max_steps=plan.steps,
        val_check_interval=min(plan.validate_every_n_steps, plan.steps),
        enable_checkpointing=False,
        _partial_=True,
    )(logger=CSVLogger(cfg.run_dir, name="", version=""), callbacks=[TrainingProgress(), TrainingLines(60.0)])
    write_config(cfg, Path(cfg.run_dir))
    order = RandomSampler(views, num_samples=plan.steps * plan.images_per_step)  # of the whole run: there are no epochs
    trainer.fit(
        module,
        DataLoader(AugmentedViews(views, cfg.seed), plan.images_per_step, sampler=order),
        DataLoader(validation, plan.images_per_step),
    )
    console.print(_gain(*module.errors, [file for file, _ in validation.views]))

    network, info = load_network(cfg.checkpoint)
    network.refinement = refinement
    model = info.model | {"refinement": OmegaConf.to_container(cfg.refinement, resolve=True)}
    method = info.method.removesuffix(_REFINED) + _REFINED
    info = replace(info, model=model, method=method, commit=code_version())
    learned = f"{plan.steps} steps on {len(views)} images of {cfg.data.name} (manifest {views.manifest.hash[:12]})"
    folder = Renderer(network.eval(), info).save(
        cfg.output, notes=f"- Its images are refined by what was learned in {learned}."
    )
    console.print(f"Network: {folder}")
    return folder


def _gain(refined: Sequence[float], unrefined: Sequence[float], scenes: Sequence[Path]) -> str:
    """What refinement is worth on validation images, with the 95% interval over scenes of the paired difference."""
    _, scene = np.unique(scenes, return_inverse=True)
    now, before = (np.bincount(scene, errors) / np.bincount(scene) for errors in (refined, unrefined))
    share = (now - before) / before.mean()
    interval = 1.96 * share.std(ddof=1) / np.sqrt(len(share))
    return f"Validation log-L1 {before.mean():.5f} → {now.mean():.5f} ({share.mean():+.1%} ± {interval:.1%})"


if __name__ == "__main__":
    main()

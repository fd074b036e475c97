"""A refinement fitted to what a network renders, as conf/refine.yaml says."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import lightning as L
from hydra.utils import instantiate
from lightning.pytorch.loggers import Logger
from torch.utils.data import DataLoader, RandomSampler

from rfpp.inference.renderer import Renderer
from rfpp.shards.dataset import ShardSplit
from rfpp.training.precision import training_precision
from rfpp.training.refining.module import RefinementModule
from rfpp.training.refining.rendered_views import AugmentedViews, RenderedViews


def rendered(
    cfg: Mapping[str, Any], renderer: Renderer, split: str, scenes: int | None, progress: Callable[[int, int], None]
) -> RenderedViews:
    """What a network renders of a split of the data set.

    Args:
        cfg: `data`, `datamodule`, `refining` and `seed` of conf/refine.yaml.
        renderer: of the network to be refined.
        scenes, progress: see `RenderedViews`.
    """
    stored = ShardSplit(cfg["data"]["root"], split, instantiate(cfg["datamodule"]["source"]["cache"]))
    plan = cfg["refining"]
    samplings = [(samples, points) for samples, points in plan["samplings"]]
    return RenderedViews(renderer, stored, samplings, cfg["seed"], Path(plan["rendered"]), progress, scenes)


def fitted(
    cfg: Mapping[str, Any],
    views: RenderedViews,
    validation: RenderedViews,
    logger: Logger | bool,
    callbacks: Sequence[L.Callback],
) -> RefinementModule:
    """A new refinement after its training; the same each time.

    Args:
        cfg: `refinement`, `refining`, `trainer` and `seed` of conf/refine.yaml.
        views: to learn from.
        validation: see `RefinementModule.validations`.
        logger, callbacks: of the trainer.
    """
    warnings.filterwarnings("ignore", message=".*(does not have many workers|exists and is not empty).*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    L.seed_everything(cfg["seed"], verbose=False)
    plan, trainer = cfg["refining"], cfg["trainer"]
    parts = (instantiate(plan[name], _convert_="all") for name in ("loss", "optimizer", "schedule"))
    module = RefinementModule(instantiate(cfg["refinement"], _convert_="all"), *parts)
    order = RandomSampler(views, num_samples=plan["steps"] * plan["images_per_step"])  # of the whole run: no epochs
    instantiate(
        trainer,
        precision=training_precision(trainer["precision"], trainer["accelerator"], None),
        max_steps=plan["steps"],
        val_check_interval=min(plan["validate_every_n_steps"], plan["steps"]),
        enable_checkpointing=False,
        _partial_=True,
    )(logger=logger, callbacks=list(callbacks)).fit(
        module,
        DataLoader(AugmentedViews(views, cfg["seed"]), plan["images_per_step"], sampler=order),
        DataLoader(validation, plan["images_per_step"]),
    )
    return module

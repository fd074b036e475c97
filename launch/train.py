"""Train a network on a data set's shards, tracked in MLflow.

python launch/train.py experiment=quickstart

The same command with the same run_dir resumes the run, even after a kill. Ctrl-C saves a checkpoint first.
"""

from __future__ import annotations

from rfpp.training.signals import STOP_SIGNALS

if __name__ == "__main__":
    STOP_SIGNALS.watch()  # what follows takes many seconds to import, in which a signal must not end this rank

import logging
import warnings
from contextlib import nullcontext
from pathlib import Path

import lightning as L
import torch
from hydra.utils import instantiate
from lightning.pytorch.loggers.logger import DummyLogger
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp.checkpoint.loading import CheckpointInfo, load_initial_weights
from rfpp.commands import entry_point
from rfpp.metrics.image import ImageMetrics
from rfpp.training.blocks import compile_blocks
from rfpp.training.callbacks.finite_gradients import NonFiniteGradientError
from rfpp.training.checkpoint_files import checkpoint_to_resume, point_at
from rfpp.training.config_file import write_config
from rfpp.training.module import RenderingModule
from rfpp.training.precision import training_precision
from rfpp.training.run import (
    divide_global_batch,
    same_folder_in_children,
    start_summary,
    trainer_plugins,
)
from rfpp.training.run_lock import only_writer_of
from rfpp.training.stopping import StoppedError, end_early
from rfpp.training.summary import end_summary
from rfpp.training.tracking import code_version


@entry_point("train")
def main(cfg: DictConfig) -> Path | None:
    """Train `cfg.model` on `cfg.data`; returns the best checkpoint's path (None after a fast_dev_run)."""
    console = Console(highlight=False, soft_wrap=True)
    untroubled = (
        "does not have many workers", "isn't picklable", "LeafSpec", "dataloader is not resumable",
        "exists and is not empty", "`srun` command is available", "Grad strides do not match",
    )  # fmt: skip
    warnings.filterwarnings("ignore", message=f".*({'|'.join(untroubled)}).*")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # devices are in our own summary
    L.seed_everything(cfg.seed, verbose=False)
    torch.set_float32_matmul_precision("high")

    run_dir = Path(cfg.run_dir)
    network = instantiate(cfg.model, _convert_="all")
    model = OmegaConf.to_container(cfg.model, resolve=True)
    resumed = checkpoint_to_resume(cfg.checkpoint, run_dir / "checkpoints", model)
    cfg.trainer.precision = training_precision(cfg.trainer.precision, cfg.trainer.accelerator, resumed)
    config = OmegaConf.to_container(cfg, resolve=True)
    if cfg.initial_weights and resumed is None:
        load_initial_weights(network, cfg.initial_weights)
    if cfg.compile:
        compile_blocks(network)
    if recomputed := instantiate(cfg.get("activation_checkpointing")):
        recomputed(network)
    datamodule = instantiate(cfg.datamodule, gbuffer_channels=network.gbuffer_channels, _convert_="all")
    loss = instantiate(cfg.loss)
    tracked = not cfg.trainer.fast_dev_run
    logger = instantiate(cfg.logger) if tracked else DummyLogger()
    info = CheckpointInfo(
        model=model,
        resolution=(cfg.data.resolution, cfg.data.resolution),
        data_manifest=datamodule.manifest.hash,
        dataset=datamodule.manifest.name,
        method=cfg.method,
        seed=cfg.seed,
        steps=0,
        commit=code_version(),
        mlflow_run_id=logger.run_id if tracked else None,
        mlflow_tracking_uri=logger.tracking_uri if tracked else None,
    )
    module = RenderingModule(
        network, loss, ImageMetrics(lpips=None), instantiate(cfg.optimizer), instantiate(cfg.schedule), info
    )
    # made in two steps, because Hydra would take a logger for a configuration
    trainer = instantiate(cfg.trainer, _partial_=True)(
        logger=logger, callbacks=list(instantiate(cfg.callbacks).values()), plugins=trainer_plugins()
    )
    divide_global_batch(trainer, datamodule)

    if trainer.is_global_zero:
        console.print(start_summary(cfg, network, datamodule, trainer))
        if resumed:
            console.print(f"Goes on from {resumed}")
    writer = only_writer_of(run_dir) if tracked and trainer.is_global_zero else nullcontext()
    try:
        with writer, same_folder_in_children(run_dir):
            if tracked and trainer.is_global_zero:
                config_file = write_config(cfg, run_dir)
                point_at(run_dir, run_dir.with_name("latest"))
                tags = {"code_version": info.commit or "unknown", "data_manifest": info.data_manifest}
                logger.describe(config, config_file, datamodule.manifest, tags | {"run_dir": str(run_dir)})
            trainer.fit(module, datamodule, ckpt_path=resumed, weights_only=True)
    except (StoppedError, NonFiniteGradientError) as stop:
        if not trainer.is_global_zero:
            return None  # all ranks have stopped, and the first one says why
        if isinstance(stop, StoppedError):
            end_early(stop, run_dir)
        raise
    if not tracked:
        return None
    # a data set without a validation split knows no best
    best = Path(trainer.checkpoint_callback.best_model_path or run_dir / "checkpoints" / "last.ckpt")
    if trainer.is_global_zero:
        console.print(end_summary(logger, best, cfg.data.root, cfg.callbacks.best.monitor))
    return best


if __name__ == "__main__":
    main()

"""Train a network on a data set's shards, tracked in MLflow.

python launch/train.py experiment=quickstart

The same command with the same run_dir resumes the run, even after a kill. Ctrl-C saves a checkpoint first.
"""

from __future__ import annotations

from rfpp.training.signals import REQUEUE, STOP_SIGNALS

if __name__ == "__main__":
    STOP_SIGNALS.watch()  # the imports below take seconds, in which a signal must not end this rank

import logging
import warnings
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path

import lightning as L
import torch
from hydra.utils import instantiate
from lightning.pytorch.utilities import rank_zero_only
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp.checkpoint.loading import CheckpointInfo, load_initial_weights
from rfpp.checkpoint.network_building import shapes_of
from rfpp.commands import entry_point, write_config
from rfpp.errors import UserError
from rfpp.metrics.image import ImageMetrics
from rfpp.training.blocks import compile_blocks
from rfpp.training.callbacks.divergence import DivergenceError
from rfpp.training.callbacks.finite_gradients import NonFiniteGradientError
from rfpp.training.callbacks.tracked_run import model_selection
from rfpp.training.checkpoint_files import AUTO, checkpoint_to_resume, point_at
from rfpp.training.module import RenderingModule
from rfpp.training.plan import PLAN_KEY, choose_acceleration, choose_precision, plan_training, require_devices
from rfpp.training.rollback import continues_job, omit_steps, omitted_steps, roll_back
from rfpp.training.run import build_trainer, folder_of, locked, trainer_plugins
from rfpp.training.steps import CapturedStep, PlainStep
from rfpp.training.stopping import StoppedError, exit_early
from rfpp.training.summary import end_summary, start_summary
from rfpp.training.tracking import code_version

#: Warnings of PyTorch and Lightning about choices that are made on purpose.
EXPECTED_WARNINGS = (
    "does not have many workers", "isn't picklable", "LeafSpec", "dataloader is not resumable",
    "exists and is not empty", "`srun` command is available", "Grad strides do not match",
)  # fmt: skip


@entry_point("train")
def main(cfg: DictConfig) -> Path | None:
    """Train `cfg.model` on `cfg.data`; return the best checkpoint's path."""
    warnings.filterwarnings("ignore", message=f".*({'|'.join(EXPECTED_WARNINGS)}).*")
    for package in ("pytorch", "fabric"):
        logging.getLogger(f"lightning.{package}").setLevel(logging.WARNING)
    logging.getLogger("lightning.pytorch.profilers").setLevel(logging.INFO)  # what trainer.profiler measures
    L.seed_everything(cfg.seed, verbose=False)
    torch.set_float32_matmul_precision("high")

    require_devices(cfg.trainer)  # what may be missing is asked for before the network is built, which takes long
    run_dir, logger = folder_of(cfg), instantiate(cfg.logger)
    data = instantiate(cfg.datamodule.source).manifest
    model = OmegaConf.to_container(cfg.model, resolve=True)
    shapes_of(model, "model")  # or hours of training would end in a checkpoint that is refused
    network = instantiate(cfg.model, _convert_="all")
    choice = AUTO if continues_job(run_dir) else cfg.checkpoint
    resumed = checkpoint_to_resume(choice, run_dir / "checkpoints", model)
    if cfg.initial_weights and resumed is None:
        load_initial_weights(network, cfg.initial_weights)
    checkpointing = instantiate(cfg.get("activation_checkpointing"))
    precision = choose_precision(cfg.trainer.precision, cfg.trainer.accelerator, resumed)
    acceleration = choose_acceleration(cfg.accelerate, cfg.trainer.accelerator, precision, checkpointing)
    if acceleration == "compiled":
        compile_blocks(network)
    if checkpointing:
        checkpointing(network)
    reads = {"gbuffer_channels": network.gbuffer_channels, "padded": acceleration != "none"}
    datamodule = instantiate(cfg.datamodule, **reads, _convert_="all")
    plan = plan_training(cfg.trainer, precision, datamodule.batching.accumulation)
    parts = [instantiate(cfg[name]) for name in ("optimizer", "schedule")]
    step = PlainStep() if acceleration == "none" else CapturedStep()
    loss = instantiate(cfg.loss)
    trainer = build_trainer(
        cfg.trainer,
        logger=logger,
        callbacks=[callback for callback in instantiate(cfg.callbacks).values() if callback],
        plugins=trainer_plugins(),
        **plan.trainer_arguments,
    )
    config = OmegaConf.to_container(cfg, resolve=True) | {PLAN_KEY: asdict(plan)}
    is_first = rank_zero_only.rank == 0
    console = Console(highlight=False, soft_wrap=True)
    try:
        with locked(run_dir) if is_first else nullcontext():
            aside = roll_back(run_dir, resumed) if is_first and choice != AUTO else None
            info = CheckpointInfo(  # the first access to `run_id` starts the MLflow run
                model=model,
                resolution=(cfg.data.resolution, cfg.data.resolution),
                data_manifest=data.hash,
                dataset=data.name,
                method=cfg.method,
                seed=cfg.seed,
                steps=0,
                commit=code_version(),
                mlflow_run_id=logger.run_id,
                mlflow_tracking_uri=logger.tracking_uri,
            )
            module = RenderingModule(network, loss, ImageMetrics(lpips=None), *parts, info, step)
            if is_first:
                summary = start_summary(cfg, plan, network, datamodule, logger, trainer.strategy.root_device)
                console.print(summary)
                if resumed:
                    console.print(f"Resumes  {resumed}")
                if aside:
                    console.print(f"Branch   what came after is in {aside}")
                config_file = write_config(config, run_dir)
                point_at(run_dir, run_dir.with_name("latest"))
                tags = {"code_version": info.commit or "unknown", "data_manifest": info.data_manifest}
                # MLflow shows the note above its tables
                tags |= {"run_dir": str(run_dir), "mlflow.note.content": f"```\n{summary}\n```"}
                logger.describe(config, config_file, data, tags)
            trainer.fit(module, datamodule, ckpt_path=resumed, weights_only=True)
    except (StoppedError, NonFiniteGradientError, DivergenceError) as stop:
        if not is_first:
            return None  # raised on all ranks, reported by the first
        if isinstance(stop, DivergenceError) and len(omitted_steps(run_dir)) < cfg.roll_backs:
            with locked(run_dir):
                start = omit_steps(run_dir, stop.steps)
            if start is not None:
                span = f"{stop.steps[0]}–{stop.steps[-1]}, where training began to diverge"
                exit_early(StoppedError(f"training goes back to {start} and omits steps {span}", REQUEUE), run_dir)
        if isinstance(stop, StoppedError):
            exit_early(stop, run_dir)
        raise
    except MisconfigurationException as error:
        raise UserError(" ".join(str(error).split())) from error
    selection = model_selection(trainer)
    best = Path((selection and selection.best_model_path) or run_dir / "checkpoints" / "last.ckpt")  # not validated
    if is_first:
        console.print(end_summary(logger, best, cfg.data.root, selection and selection.monitor))
    return best


if __name__ == "__main__":
    main()

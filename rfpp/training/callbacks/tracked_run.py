"""Keep the logger in step with checkpoints, log the best score, and register the best checkpoint at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.callbacks import ModelCheckpoint

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.training.stopping import StoppedError
from rfpp.training.tracking.registry import CHECKPOINT, FOLDER
from rfpp.training.tracking.run_logger import RunLogger


class TrackedRun(L.Callback):
    """Callback that flushes the journal before each checkpoint, and registers the best one after training.

    The best score so far is logged as `best/log_l1`, if `validation/log_l1` chooses checkpoints: MLflow's table shows
    the last value of a metric.

    A resumed run logs only the steps after its checkpoint, so the records of earlier steps must be on disk.

    Args:
        model_name: Name in MLflow's model registry; None: do not register.
    """

    def __init__(self, model_name: str | None):
        self.model_name = model_name

    def on_save_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        for logger in _loggers(trainer):
            logger.sync()

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        monitor = model_selection(trainer)
        if trainer.sanity_checking or monitor is None or monitor.monitor not in trainer.callback_metrics:
            return
        scores = [trainer.callback_metrics[monitor.monitor], monitor.best_model_score]  # the latter of those before
        best = {"min": min, "max": max}[monitor.mode](float(score) for score in scores if score is not None)
        for logger in _loggers(trainer):
            logger.log_metrics({f"best/{monitor.monitor.rpartition('/')[2]}": best}, trainer.global_step - 1)

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        if isinstance(exception, StoppedError):
            for logger in _loggers(trainer):
                logger.mark_stopped()

    def on_fit_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        selection = model_selection(trainer)
        best = selection and selection.best_model_path
        complete = trainer.global_step >= trainer.max_steps
        if not (trainer.is_global_zero and complete and best and self.model_name):
            return
        for logger in _loggers(trainer):
            file = strip_training_state(Path(best), logger.run_dir / FOLDER / CHECKPOINT)
            logger.register_model(self.model_name, file)


def model_selection(trainer: L.Trainer) -> ModelCheckpoint | None:
    """Return the callback that keeps the best checkpoint; None if the configuration has left it out."""
    return next((each for each in trainer.checkpoint_callbacks if isinstance(each, ModelCheckpoint)), None)


def strip_training_state(checkpoint: Path, target: Path) -> Path:
    """Write only weights and model description, a third of the size; return `target`."""
    content = torch.load(checkpoint, map_location="cpu", weights_only=True)
    target.parent.mkdir(exist_ok=True)
    temporary = target.with_suffix(".tmp")
    torch.save({name: content[name] for name in (CHECKPOINT_KEY, "state_dict")}, temporary)
    temporary.replace(target)
    return target


def _loggers(trainer: L.Trainer) -> Iterator[RunLogger]:
    return (logger for logger in trainer.loggers if isinstance(logger, RunLogger))

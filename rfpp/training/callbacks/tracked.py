"""Keep the logger in step with checkpoints, and register the best one at the end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lightning as L
import torch

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.training.stopping import StoppedError
from rfpp.training.tracking.run_logger import RunLogger


class TrackedRun(L.Callback):
    """Flushes the journal before each checkpoint, and registers the best checkpoint when training is complete.

    A run that goes on from a checkpoint logs the steps after it, so those before it must be safe by then, this very
    step's too.

    Args:
        model_name: in MLflow's model registry; None registers nothing.
    """

    def __init__(self, model_name: str | None):
        self.model_name = model_name

    def on_save_checkpoint(self, trainer: L.Trainer, module: L.LightningModule, checkpoint: dict[str, Any]) -> None:
        connector = trainer._logger_connector  # Lightning logs a step after its callbacks, among which are we
        if trainer.training and connector._first_loop_iter is not None:
            connector.update_train_step_metrics()
        for logger in _loggers(trainer):
            logger.sync()

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        if isinstance(exception, StoppedError):
            for logger in _loggers(trainer):
                logger.will_go_on()

    def on_fit_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        best = trainer.checkpoint_callback and trainer.checkpoint_callback.best_model_path
        complete = trainer.global_step >= trainer.max_steps
        if not (trainer.is_global_zero and complete and best and self.model_name):
            return
        for logger in _loggers(trainer):
            logger.register_model(self.model_name, without_training_state(Path(best), logger.run_dir / "model.ckpt"))


def without_training_state(checkpoint: Path, target: Path) -> Path:
    """Write only weights and model description, a third of the size; returns `target`."""
    content = torch.load(checkpoint, map_location="cpu", weights_only=True)
    temporary = target.with_suffix(".tmp")
    torch.save({name: content[name] for name in (CHECKPOINT_KEY, "state_dict")}, temporary)
    temporary.replace(target)
    return target


def _loggers(trainer: L.Trainer) -> Iterator[RunLogger]:
    return (logger for logger in trainer.loggers if isinstance(logger, RunLogger))

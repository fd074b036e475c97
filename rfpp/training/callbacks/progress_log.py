"""Training progress as log lines."""

from __future__ import annotations

import sys
from typing import Any

import lightning as L

from rfpp.progress_lines import ProgressLines


class TrainingLines(L.Callback):
    """Prints a line per minute from rank 0 if the output is a file or a pipe; the first after ten steps.

    Args:
        every_n_seconds: between lines.
    """

    def __init__(self, every_n_seconds: float):
        self.every_n_seconds = every_n_seconds
        self._lines: ProgressLines | None = None

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.is_global_zero and not sys.stdout.isatty():
            self._lines = ProgressLines("steps", _write, self.every_n_seconds)
            self._lines(trainer.global_step, trainer.max_steps)

    def on_train_batch_end(self, trainer: L.Trainer, pl_module: L.LightningModule, *_: Any) -> None:
        if self._lines is not None:
            self._lines(trainer.global_step, trainer.max_steps)


def _write(line: str) -> None:
    print(line, flush=True)

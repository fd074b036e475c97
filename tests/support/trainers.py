"""A trainer for callbacks, which no one trains with: what they ask of one, and batches of random scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from types import SimpleNamespace

import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers.logger import Logger
from random_scenes import random_views

from rfpp.batch import RaggedBatch


class StillTrainer(L.Trainer):
    """Attributes are set by whoever needs them; ranks and devices there is one of."""

    # Lightning has properties for these
    global_step = global_rank = max_steps = 0
    world_size = accumulate_grad_batches = log_every_n_steps = 1
    is_global_zero, sanity_checking, precision = True, False, "32-true"
    callback_metrics: Mapping[str, torch.Tensor] = {}
    loggers: Sequence[Logger] = ()
    checkpoint_callbacks = ()
    strategy = SimpleNamespace(
        root_device=torch.device("cpu"), reduce=lambda values, reduce_op: values, all_gather=lambda values: values
    )
    precision_plugin = SimpleNamespace(forward_context=nullcontext)

    def __init__(self, **attributes) -> None:
        for name, value in attributes.items():
            setattr(self, name, value)


class Recorder(Logger):
    """Remembers (step, metrics)."""

    name = version = None

    def __init__(self) -> None:
        super().__init__()
        self.logged: list[tuple[int, dict[str, float]]] = []

    def log_metrics(self, metrics, step=None) -> None:
        self.logged.append((step, dict(metrics)))

    def log_hyperparams(self, params) -> None:
        raise NotImplementedError


class RecordingModule(L.LightningModule):
    """Remembers what callbacks log by way of it."""

    def __init__(self, **attributes) -> None:
        super().__init__()
        self.logged: dict[str, float] = {}
        for name, value in attributes.items():
            setattr(self, name, value)

    def log(self, name, value, **_) -> None:
        self.logged[name] = float(value)

    def log_dict(self, values, **_) -> None:
        self.logged |= {name: float(value) for name, value in values.items()}


def batch_of(*sizes: Sequence[int], channels: int = 7, views: int = 2, pixels: int = 8) -> RaggedBatch:
    """A scene for each of these, with objects of so many triangles."""
    rng = np.random.default_rng(0)
    return RaggedBatch.pack([random_views(rng, of, views, pixels, channels) for of in sizes])

"""Tasks for the cost benchmark that exceed a limit, but only with RenderFormer."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch

from rfpp.benchmark.cost.tasks import Inference

#: Bytes that `Hungry` allocates with other networks.
MODERATE = 300_000_000


@dataclass(frozen=True)
class Sleepy(Inference):
    """Task that never finishes."""

    def prepare(self, name, network, batch, setting):
        run = super().prepare(name, network, batch, setting)
        return (lambda: time.sleep(600)) if name == "RenderFormer" else run


@dataclass(frozen=True)
class Hungry(Inference):
    """Task that allocates `bytes`, then frees them."""

    bytes: int

    def prepare(self, name, network, batch, setting):
        run = super().prepare(name, network, batch, setting)

        def eat():
            parts = []
            for _ in range(max(1, (self.bytes if name == "RenderFormer" else MODERATE) // MODERATE)):
                parts.append(torch.ones(MODERATE // 4))
                time.sleep(0.03)
            return run()

        return eat

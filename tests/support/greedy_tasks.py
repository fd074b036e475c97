"""Tasks for the cost benchmark that take too much, but only of a network with a token per triangle."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch

from rfpp.benchmark.cost.tasks import Inference
from rfpp.model.renderformer.triangle_tokens import TriangleTokens

#: Bytes that `Hungry` takes at once.
BITE = 50_000_000
#: What it takes with other networks.
MODERATE = 300_000_000


@dataclass(frozen=True)
class Sleepy(Inference):
    """Never ends."""

    def prepared(self, network, batch, setting):
        run = super().prepared(network, batch, setting)
        return (lambda: time.sleep(600)) if isinstance(network.tokenizer, TriangleTokens) else run


@dataclass(frozen=True)
class Hungry(Inference):
    """Holds three gigabytes, then forgets them."""

    def prepared(self, network, batch, setting):
        run = super().prepared(network, batch, setting)
        most = 3_000_000_000 if isinstance(network.tokenizer, TriangleTokens) else MODERATE

        def eat():
            eaten = []
            while BITE * len(eaten) < most:
                eaten.append(torch.ones(BITE // 4))
                time.sleep(0.03)
            return run()

        return eat

"""The LightningModule that trains a refinement."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from rfpp.imaging.radiance import log_encode
from rfpp.losses.log_l1 import log_l1
from rfpp.radiosity.refinement import Refinement


@dataclass(frozen=True)
class Validation:
    """Attributes:
    step: after which it was.
    minutes: of training until then, with the validations before.
    refined, unrefined: log-L1 of each image.
    """

    step: int
    minutes: float
    refined: list[float]
    unrefined: list[float]


class RefinementModule(L.LightningModule):
    """Minimises a loss of refined images; logs log-L1 of validation images, refined and not.

    Args:
        refinement: to be trained.
        loss: of linear radiance and its reference.
        optimizer: parameters → optimizer.
        schedule: optimizer → learning-rate schedule, stepped once per optimizer step.
    """

    def __init__(
        self,
        refinement: Refinement,
        loss: Callable[[Tensor, Tensor], Tensor],
        optimizer: Callable[[Iterable[torch.nn.Parameter]], Optimizer],
        schedule: Callable[[Optimizer], LRScheduler],
    ):
        super().__init__()
        self.refinement, self._loss, self._optimizer, self._schedule = refinement, loss, optimizer, schedule
        #: From the first to the last.
        self.validations: list[Validation] = []
        self._begin = time.monotonic()

    def forward(self, batch: dict[str, Tensor]) -> Tensor:
        """[N, 3, H, W] linear radiance."""
        refined: Tensor = self.refinement(batch["radiance"], batch["surfaces"], batch["fov"])
        return refined

    def training_step(self, batch: dict[str, Tensor], _: int) -> Tensor:
        loss = self._loss(self(batch), batch["reference"])
        self.log("train/loss", loss.detach(), prog_bar=True)
        return loss

    def on_train_start(self) -> None:
        self._begin = time.monotonic()

    def on_validation_epoch_start(self) -> None:
        minutes = (time.monotonic() - self._begin) / 60
        self.validations.append(Validation(self.global_step, minutes, [], []))

    def validation_step(self, batch: dict[str, Tensor], _: int) -> None:
        now = self.validations[-1]
        for errors, images in ((now.refined, self(batch)), (now.unrefined, batch["radiance"])):
            pairs = zip(images, batch["reference"], strict=True)
            errors += [log_l1(log_encode(image), reference).item() for image, reference in pairs]

    def on_validation_epoch_end(self) -> None:
        now = self.validations[-1]
        for name, errors in (("log_l1", now.refined), ("unrefined_log_l1", now.unrefined)):
            self.log(f"validation/{name}", sum(errors) / len(errors), prog_bar=name == "log_l1")

    def configure_optimizers(self) -> dict[str, Any]:
        optimizer = self._optimizer(self.refinement.parameters())
        schedule = {"scheduler": self._schedule(optimizer), "interval": "step", "name": "learning_rate"}
        return {"optimizer": optimizer, "lr_scheduler": schedule}

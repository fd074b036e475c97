"""LightningModule that trains a network."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import lightning as L
import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler
from torchmetrics import MeanMetric

from rfpp.batch import RaggedBatch
from rfpp.checkpoint.loading import CHECKPOINT_KEY, CheckpointInfo
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_decode
from rfpp.losses.rendering import RenderingLoss
from rfpp.metrics.image import ImageMetrics
from rfpp.model.renderformer_pp import Rendering
from rfpp.training.steps import CapturedStep, PlainStep


class RenderingModule(L.LightningModule):
    """Network, loss and logging.

    Args:
        info: Description of the network in checkpoints, from which they load without this class.
        step: How the loss is differentiated.
    """

    def __init__(
        self,
        network: nn.Module,
        loss: RenderingLoss,
        metrics: ImageMetrics,
        optimizer: Callable[[Iterable[dict]], Optimizer],
        schedule: Callable[[Optimizer], LRScheduler],
        info: CheckpointInfo,
        step: PlainStep | CapturedStep,
    ):
        super().__init__()
        self.network, self.loss, self.metrics, self.info = network, loss, metrics, info
        self.step, self._optimizer, self._schedule = step, optimizer, schedule
        # sums and counts over all ranks: Lightning's own means differ where ranks have unequal numbers of images
        self.validation = nn.ModuleDict({name: MeanMetric().set_dtype(torch.float64) for name in metrics.names})

    def forward(self, batch: RaggedBatch) -> Rendering:
        return self.network(batch)

    def training_step(self, batch: RaggedBatch, _: int) -> dict[str, Any]:
        """Return `loss`; `terms`, the means of its terms by the names of their metrics; and `tokens`, their number."""
        terms, tokens = self.step(self.network, self.loss, batch)
        rate = self.optimizers(use_pl_optimizer=False).param_groups[0]["lr"]  # the same in all groups
        self.log("train/learning_rate", rate)
        # a step averages over its batches; weighting by scenes gives each scene the same weight if others are skipped
        loss = terms["loss"] * (len(batch.keys) / self.trainer.datamodule.scenes_per_batch)
        named = {metric_name(term): value.detach() for term, value in terms.items()}
        return {"loss": loss, "terms": named, "tokens": torch.tensor(tokens)}

    def validation_step(self, batch: RaggedBatch, _: int) -> dict[str, Tensor]:
        """Log all metrics; return `radiance` [B, V, 3, H, W] for callbacks."""
        radiance = log_decode(self(batch).log_radiance)
        for name, per_image in self.metrics(radiance.flatten(0, 1), batch.image.flatten(0, 1)).items():
            self.validation[name].update(per_image.double())
            self.log(f"validation/{name}", self.validation[name])
        return {"radiance": radiance}

    def configure_optimizers(self) -> dict[str, Any]:
        optimizer = self._optimizer(decay_groups(nn.ModuleList([self.network, self.loss])))
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": self._schedule(optimizer), "interval": "step"}}

    def configure_gradient_clipping(
        self, optimizer: Optimizer, gradient_clip_val: float | None = None, gradient_clip_algorithm: str | None = None
    ) -> None:
        """Clip gradients by their global norm, and log it.

        Lightning's implementation rejects fused optimizers, because of a gradient scaler that bfloat16 does not need.
        """
        trained = [p for group in optimizer.param_groups for p in group["params"]]  # walking modules takes 0.5 ms
        norm = torch.nn.utils.clip_grad_norm_(trained, gradient_clip_val or float("inf"))
        self.log("train/gradient_norm", norm)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the configured learning rate, weight decay etc., which Lightning would replace by the checkpoint's.

        Raises:
            UserError: If the checkpoint holds the state of another optimizer.
        """
        [state], [schedule] = checkpoint["optimizer_states"], checkpoint["lr_schedulers"]
        configured = self.configure_optimizers()["optimizer"].param_groups
        for group, new in zip(state["param_groups"], configured, strict=True):
            if group.keys() != new.keys():
                raise UserError(
                    "the run to resume had another optimizer: use it, or initial_weights=… in another run_dir"
                )
            if group["initial_lr"] != new["initial_lr"]:
                group["lr"] *= new["initial_lr"] / group["initial_lr"]
            group.update({name: value for name, value in new.items() if name not in ("params", "lr")})
        schedule["base_lrs"] = [group["initial_lr"] for group in configured]

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint[CHECKPOINT_KEY] = replace(
            self.info, steps=self.global_step, mlflow_run_id=getattr(self.logger, "run_id", None)
        ).to_dict()


def metric_name(term: str) -> str:
    """Return the metric of a loss term: `train/l1`, or `consistency/k1` for the residual of the first iteration."""
    prefix, _, number = term.rpartition("_")
    return f"consistency/k{number}" if prefix == "consistency" and number.isdigit() else f"train/{term}"


def decay_groups(network: nn.Module) -> list[dict]:
    """Return two parameter groups: matrices with weight decay, and vectors such as norms and biases without."""
    matrices = [p for p in network.parameters() if p.ndim >= 2]
    others = [p for p in network.parameters() if p.ndim < 2]
    return [{"params": matrices}, {"params": others, "weight_decay": 0.0}]

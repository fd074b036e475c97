"""The LightningModule: network, loss and logging."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import lightning as L
import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from rfpp.batch import RaggedBatch
from rfpp.checkpoint.loading import CHECKPOINT_KEY, CheckpointInfo
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_decode
from rfpp.losses.rendering import RenderingLoss
from rfpp.metrics.image import ImageMetrics
from rfpp.model.layers.block import CrossAttention, SelfAttention, SwiGLU
from rfpp.model.renderformer_pp import Rendering


class RenderingModule(L.LightningModule):
    """Trains a network to render.

    Args:
        network: RaggedBatch → Rendering.
        loss: see RenderingLoss.
        metrics: of validation, on linear radiance.
        optimizer: parameter groups → optimizer.
        schedule: optimizer → learning-rate schedule, stepped once per optimizer step.
        info: what the checkpoint says about itself, so that it can be loaded without this class.
    """

    def __init__(
        self,
        network: nn.Module,
        loss: RenderingLoss,
        metrics: ImageMetrics,
        optimizer: Callable[[Iterable[dict]], Optimizer],
        schedule: Callable[[Optimizer], LRScheduler],
        info: CheckpointInfo,
    ):
        super().__init__()
        self.network, self.loss, self.metrics, self.info = network, loss, metrics, info
        self._optimizer, self._schedule = optimizer, schedule

    def forward(self, batch: RaggedBatch) -> Rendering:
        return self.network(batch)

    def training_step(self, batch: RaggedBatch, _: int) -> dict[str, Tensor]:
        rendering = self(batch)
        terms = self.loss(
            rendering.log_radiance,
            rendering.transport_states,
            batch.image,
            rendering.token_segments,
        )
        named_elsewhere = ("loss", "consistency_")  # the second by ConsistencyMonitor
        scalars = {f"train/{k}": v.detach() for k, v in terms.items() if not k.startswith(named_elsewhere)}
        self.log("train/loss", terms["loss"].detach(), prog_bar=True, batch_size=len(batch.keys))
        self.log_dict(scalars, batch_size=len(batch.keys))
        # a step takes the mean over its batches: where scenes were left out, those that are there keep their weight
        loss = terms["loss"] * (len(batch.keys) / self.trainer.datamodule.scenes_per_batch)
        return terms | {"loss": loss, "tokens": torch.tensor(rendering.token_segments.total)}

    def validation_step(self, batch: RaggedBatch, _: int) -> dict[str, Tensor]:
        """Logs every metric; returns for the callbacks `radiance` [B, V, 3, H, W] and every metric's values [B · V]."""
        radiance = log_decode(self(batch).log_radiance)
        values = self.metrics(radiance.flatten(0, 1), batch.image.flatten(0, 1))
        for name, per_image in values.items():
            self.log(
                f"validation/{name}",
                per_image.mean(),
                batch_size=len(per_image),
                sync_dist=True,
                prog_bar=name == "log_l1",
            )
        return {"radiance": radiance, **values}

    def configure_optimizers(self) -> dict[str, Any]:
        optimizer = self._optimizer(decay_groups(self.network))
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": self._schedule(optimizer), "interval": "step", "name": "learning_rate"},
        }

    def configure_gradient_clipping(
        self, optimizer: Optimizer, gradient_clip_val: float | None = None, gradient_clip_algorithm: str | None = None
    ) -> None:
        """Clip by the global norm. Lightning's own refuses fused optimizers, for a scaler that bfloat16 has not."""
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), gradient_clip_val or float("inf"))
        self.log("train/gradient_norm", norm)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Raises UserError if the checkpoint's state is of another optimizer."""
        (state,) = checkpoint["optimizer_states"]
        if _shape(state["param_groups"]) != _shape(self._optimizer(decay_groups(self.network)).param_groups):
            raise UserError(
                "the run to resume had another optimizer: set it so, or start anew from its weights (initial_weights)"
            )

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint[CHECKPOINT_KEY] = replace(
            self.info, steps=self.global_step, mlflow_run_id=getattr(self.logger, "run_id", None)
        ).to_dict()


#: Key of a parameter group: of each parameter, whether it is a matrix of a hidden layer; some optimizers ask.
HIDDEN = "hidden"


def decay_groups(network: nn.Module) -> list[dict]:
    """Two parameter groups: weight decay (the optimizer's) for matrices, none for norms, biases and tokens."""
    layers = [part for part in network.modules() if isinstance(part, SelfAttention | CrossAttention | SwiGLU)]
    hidden = {p for layer in layers for p in layer.parameters() if p.ndim == 2}
    matrices = [p for p in network.parameters() if p.ndim >= 2]
    others = [p for p in network.parameters() if p.ndim < 2]
    return [{"params": matrices, HIDDEN: [p in hidden for p in matrices]}, {"params": others, "weight_decay": 0.0}]


def _shape(groups: Sequence[Mapping[str, Any]]) -> list[tuple[int, bool]]:
    """Properties in which optimizer states must agree: parameters per group, and use of momentum only."""
    return [(len(group["params"]), "betas" in group) for group in groups]

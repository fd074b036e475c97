"""Tasks to measure: rendering, and training steps with and without activation checkpointing.

A task prepares a network and a batch on the setting's device, and returns a function that executes it once. The last of
its quantities covers the whole task, and peak memory belongs to it. `flops` counts the operations of each quantity for
a network and a batch on "meta".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.optim import Optimizer
from torch.utils.flop_counter import FlopCounterMode

from rfpp.allocator import keep_freed_memory
from rfpp.batch import RaggedBatch
from rfpp.checkpoint.network_building import build
from rfpp.errors import UserError
from rfpp.inference.object_encoder import ObjectEncoder
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.hoct import ObjectTokens
from rfpp.model.layers.matrix_precision import convert_blocks
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.training.flops import training_flops
from rfpp.training.module import decay_groups

#: Data types of matrix products, by Lightning's names.
PRECISIONS = {"bf16-mixed": torch.bfloat16, "32-true": torch.float32}

#: Execute a task once; return the seconds of each quantity.
Run = Callable[[], dict[str, float]]


@dataclass(frozen=True)
class Untrained:
    """Network with random weights, which costs as much as a trained one."""

    name: str
    model: dict[str, Any]

    def __call__(self, device: str) -> RenderFormerPP:
        """Build the network; on "meta" it has shapes but takes no memory."""
        with torch.device(device):
            return build(self.model, self.name).to(device)


@dataclass(frozen=True)
class Setting:
    """Device and precision of all measurements.

    Attributes:
        device: "cpu", "cuda", or "auto" for a GPU if there is one.
        precision: "bf16-mixed" (autocast, as in training) or "32-true".
    """

    device: str
    precision: str

    def __post_init__(self) -> None:
        if self.precision not in PRECISIONS:
            raise UserError(f"precision={self.precision}: choose from {', '.join(PRECISIONS)}")
        if self.device not in ("auto", "cpu", "cuda"):
            raise UserError(f"device={self.device}: choose from auto, cpu, cuda")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise UserError("device=cuda: PyTorch finds no GPU: choose device=cpu")

    @property
    def where(self) -> str:
        """The device in use, "cpu" or "cuda"."""
        return ("cuda" if torch.cuda.is_available() else "cpu") if self.device == "auto" else self.device

    @property
    def dtype(self) -> torch.dtype:
        """Data type of matrix products."""
        return PRECISIONS[self.precision]

    def apply(self) -> None:
        """Configure this process as training and rendering do."""
        keep_freed_memory()
        torch.set_float32_matmul_precision("high")
        torch.manual_seed(0)

    def autocast(self) -> torch.autocast:
        """Return a new autocast context."""
        return torch.autocast(self.where, self.dtype, enabled=self.dtype != torch.float32)

    def now(self) -> float:
        """Wait for the device, then return the time in seconds."""
        if self.where == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()


@dataclass(frozen=True)
class Inference:
    """Rendering of all views of a batch, one view of every scene at a time, as the renderer does it.

    Quantities: `encode` is the view-independent stage, `view` one view, `render` the encoding and all views.
    """

    quantities = ("encode", "view", "render")

    def prepare(self, name: str, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Run:
        network.eval()
        convert_blocks(network, setting.dtype)
        on_cpu = batch.to("cpu")
        by_object = isinstance(network.tokenizer, ObjectTokens)

        @torch.inference_mode()
        def run() -> dict[str, float]:
            with setting.autocast():
                begin = setting.now()
                if by_object:  # a new encoder, which has no tokens cached
                    encoder = ObjectEncoder(network, torch.device(setting.where))
                    scenes = network.transported(*encoder.tokenize(on_cpu))
                else:
                    scenes = network.encode(batch)
                encoded = setting.now()
                for v in range(batch.num_views):
                    one = slice(v, v + 1)
                    network.view(scenes, batch.c2w[:, one], batch.fov[:, one], batch.gbuffer[:, one])
                end = setting.now()
            return {"encode": encoded - begin, "view": (end - encoded) / batch.num_views, "render": end - begin}

        return run

    @torch.no_grad()
    def flops(self, network: RenderFormerPP, batch: RaggedBatch) -> dict[str, float]:
        with FlopCounterMode(display=False) as encode:
            scenes = network.encode(batch)
        with FlopCounterMode(display=False) as view:
            network.view(scenes, batch.c2w[:, :1], batch.fov[:, :1], batch.gbuffer[:, :1])
        counts = float(encode.get_total_flops()), float(view.get_total_flops())
        return {"encode": counts[0], "view": counts[1], "render": counts[0] + batch.num_views * counts[1]}


@dataclass(frozen=True)
class TrainingStep:
    """Forward pass, loss, backward pass, gradient clipping and optimizer step.

    Attributes:
        quantity: Name of the step in the rows.
        checkpointing: Network name → activation checkpointing; other networks keep all activations.
    """

    quantity: str
    loss: RenderingLoss
    optimizer: Callable[..., Optimizer]
    gradient_clip: float | int
    checkpointing: Mapping[str, Callable[[nn.Module], None]]

    @property
    def quantities(self) -> tuple[str, ...]:
        return (self.quantity,)

    def prepare(self, name: str, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Run:
        network.train()
        if name in self.checkpointing:
            self.checkpointing[name](network)
        loss, optimizer = self.loss.to(setting.where), self.optimizer(decay_groups(network))
        # allocate gradients and moments now: they exist in every step but the first
        for parameter in network.parameters():
            parameter.grad = torch.zeros_like(parameter)
        optimizer.step()

        def run() -> dict[str, float]:
            begin = setting.now()
            with setting.autocast():
                rendering = network(batch)
                states, segments = rendering.transport_states, rendering.token_segments
                terms = loss(rendering.log_radiance, states, batch.image, segments)
            optimizer.zero_grad()  # after the forward pass, as in Lightning: this decides the peak of memory
            terms["loss"].backward()
            nn.utils.clip_grad_norm_(network.parameters(), self.gradient_clip)
            optimizer.step()
            return {self.quantity: setting.now() - begin}

        return run

    def flops(self, network: RenderFormerPP, batch: RaggedBatch) -> dict[str, float]:
        return {self.quantity: training_flops(network, batch)}  # recomputation is not counted


Task = Inference | TrainingStep

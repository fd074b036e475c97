"""Timed tasks: rendering and training steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

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
from rfpp.model.layers.matrix_precision import convert_blocks
from rfpp.model.renderformer_pp import EncodedScenes, RenderFormerPP
from rfpp.model.hoct import ObjectTokens
from rfpp.training.blocks import RecomputedBlocks, RecomputedObjects, compile_blocks
from rfpp.training.flops import training_flops
from rfpp.training.module import decay_groups

#: By Lightning's names.
PRECISIONS = {"bf16-mixed": torch.bfloat16, "32-true": torch.float32}


@dataclass(frozen=True)
class Untrained:
    """A network to be made where it is needed: random weights cost what trained ones do.

    Attributes:
        name: in the rows.
        model: nested `_target_` config.
    """

    name: str
    model: dict[str, Any]

    def __call__(self, device: str) -> RenderFormerPP:
        """On "meta" it takes no memory, and computes shapes only."""
        with torch.device(device):
            return build(self.model, self.name).to(device)


@dataclass(frozen=True)
class Setting:
    """How every network runs.

    Attributes:
        device: "cpu", "cuda", or "auto": a GPU if there is one.
        precision: "bf16-mixed" (autocast, as in training) or "32-true".
        threads: of the CPU; None: as many as PyTorch chooses.
        compile: the transformer blocks, as training does where it is asked to.
        seed: of weights and scenes.
    """

    device: str
    precision: str
    threads: int | None
    compile: bool
    seed: int

    def __post_init__(self) -> None:
        if self.precision not in PRECISIONS:
            raise UserError(f"precision={self.precision}: choose from {', '.join(PRECISIONS)}")
        if self.device not in ("auto", "cpu", "cuda"):
            raise UserError(f"device={self.device}: choose from auto, cpu, cuda")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise UserError("device=cuda: PyTorch finds no GPU: choose device=cpu")

    @cached_property
    def where(self) -> str:
        """ "cpu" or "cuda"."""
        return ("cuda" if torch.cuda.is_available() else "cpu") if self.device == "auto" else self.device

    @property
    def dtype(self) -> torch.dtype:
        """Of matrix products."""
        return PRECISIONS[self.precision]

    def apply(self) -> None:
        """To this process, as the commands do."""
        keep_freed_memory()
        torch.set_float32_matmul_precision("high")
        torch.manual_seed(self.seed)
        if self.threads is not None:
            torch.set_num_threads(self.threads)

    def network(self, untrained: Untrained) -> RenderFormerPP:
        """On the device."""
        made = untrained(self.where)
        if self.compile:
            compile_blocks(made)
        return made

    def autocast(self) -> torch.autocast:
        return torch.autocast(self.where, self.dtype, enabled=self.dtype != torch.float32)

    def now(self) -> float:
        """Seconds, once the device has done all it was asked to do."""
        if self.where == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()


@runtime_checkable
class Task(Protocol):
    """Something to be timed again and again.

    Attributes:
        quantities: names of what is measured, the whole last: it is what the peak of memory belongs to.
    """

    quantities: ClassVar[tuple[str, ...]]

    def prepared(self, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Callable[[], dict[str, float]]:
        """What does the task once and returns the seconds of each quantity."""

    def flops(self, network: RenderFormerPP, batch: RaggedBatch) -> dict[str, float]:
        """Operations of each quantity."""


@dataclass(frozen=True)
class Inference:
    """encode: the view-independent stage; view: one view of every scene; render: encode, and all views in turn.

    As the renderer does it, which remembers nothing here.
    """

    quantities = ("encode", "view", "render")

    def prepared(self, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Callable[[], dict[str, float]]:
        network.eval()
        convert_blocks(network, setting.dtype)
        on_cpu = batch.to("cpu")

        def encode() -> EncodedScenes:
            if isinstance(network.tokenizer, ObjectTokens):
                return ObjectEncoder(network, torch.device(setting.where)).encode(on_cpu)
            return network.encode(batch)

        @torch.inference_mode()
        def run() -> dict[str, float]:
            with setting.autocast():
                begin = setting.now()
                scenes = encode()
                encoded = setting.now()
                for v in range(batch.num_views):  # one at a time, as the renderer does
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
    """Forward pass, loss, backward pass, clipping, and the optimizer's step.

    Attributes:
        loss: see RenderingLoss.
        optimizer: parameter groups → optimizer.
        gradient_clip: largest norm of the gradient.
    """

    loss: RenderingLoss
    optimizer: Callable[..., Optimizer]
    gradient_clip: float | int

    quantities = ("training_step",)

    def prepared(self, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Callable[[], dict[str, float]]:
        network.train()
        loss, optimizer = self.loss.to(setting.where), self.optimizer(decay_groups(network))
        # gradients and moments are there from the first step on, as they are in all later ones
        for parameter in network.parameters():
            parameter.grad = torch.zeros_like(parameter)
        optimizer.step()

        def run() -> dict[str, float]:
            begin = setting.now()
            with setting.autocast():
                made = network(batch)
                terms = loss(made.log_radiance, made.transport_states, batch.image, made.token_segments)
            optimizer.zero_grad()  # where Lightning does it, which decides what memory holds at once
            terms["loss"].backward()
            nn.utils.clip_grad_norm_(network.parameters(), self.gradient_clip)
            optimizer.step()
            return {self.quantities[-1]: setting.now() - begin}

        return run

    def flops(self, network: RenderFormerPP, batch: RaggedBatch) -> dict[str, float]:
        return {self.quantities[-1]: training_flops(network, batch)}


@dataclass(frozen=True)
class CheckpointedTrainingStep(TrainingStep):
    """The same with activation checkpointing; what is computed anew does not count as operations.

    Attributes:
        policy: of every network.
    """

    policy: RecomputedBlocks

    quantities = ("checkpointed_training_step",)

    def prepared(self, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Callable[[], dict[str, float]]:
        self.policy(network)
        return super().prepared(network, batch, setting)


@dataclass(frozen=True)
class LeastMemoryTrainingStep(TrainingStep):
    """The same with the activation checkpointing that leaves each network the least memory.

    Attributes:
        by_object, otherwise: of networks with and without object tokens.
    """

    by_object: RecomputedObjects
    otherwise: RecomputedBlocks

    quantities = ("least_memory_training_step",)

    def prepared(self, network: RenderFormerPP, batch: RaggedBatch, setting: Setting) -> Callable[[], dict[str, float]]:
        policy = self.by_object if isinstance(network.tokenizer, ObjectTokens) else self.otherwise
        policy(network)
        return super().prepared(network, batch, setting)

"""Time, memory and kernels of training steps and pictures, as `launch/train.py` and the renderer execute them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Literal

import torch
from torch import nn
from torch.autograd import DeviceType
from torch.optim import Optimizer
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from rfpp.allocator import keep_freed_memory
from rfpp.batch import RaggedBatch
from rfpp.benchmark.case import Case
from rfpp.benchmark.csv_rows import Row, read_rows
from rfpp.checkpoint.network_building import build
from rfpp.errors import UserError
from rfpp.inference.captured import CapturedStages
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.layers.matrix_precision import convert_blocks
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.training.blocks import compile_blocks
from rfpp.training.flops import published_peak, training_flops
from rfpp.training.module import decay_groups
from rfpp.training.steps import CapturedStep, PlainStep

QUANTITIES = ("training_step", "encode", "view")
#: Columns that identify a row.
IDENTITY = ("network", "size", "quantity", "acceleration", *Case.__dataclass_fields__, "device")

_SEED = 0
_LEAST_ROUNDS = 5


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
class TrainingParts:
    """Loss, optimizer and gradient norm of a training step."""

    loss: RenderingLoss
    optimizer: Callable[..., Optimizer]
    gradient_clip: float


def measure(
    networks: Mapping[str, Untrained],
    size: str,
    training: TrainingParts,
    case: Case,
    groups: Sequence[Mapping[str, Any]],
    device: Literal["cpu", "cuda", "auto"],
    seconds: float | int,
    most_seconds: float | int,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row for each quantity of each group and network, the baseline first.

    `training_step` is forward, loss, backward, clipping and optimizer; `encode` and `view` are the stages of a picture.
    `seconds` is the median over rounds, `TFLOP` the counted operations. On a GPU, `host_seconds` is what the host needs
    to launch a round, `kernels` their number, `busy` the share of the time in which a kernel runs, `of_peak` the rate
    as a share of the card's published rate (MFU), `peak_GB` the maximum that tensors took.

    Args:
        groups: Changes of the case, with `quantities` and, on a GPU, `acceleration`
            (`rfpp.training.plan.ACCELERATIONS`).
        device: "cpu", "cuda", or "auto" for a GPU if there is one.
        seconds: Least duration of a row, which has five rounds or more.
        most_seconds: Duration after which no further round begins.
        finished: Table whose rows are kept and not measured again.

    Raises:
        UserError: Without the GPU that `device` asks for, if a group is wrong, or if `finished` is not such a table.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise UserError("benchmark.device=cuda: PyTorch finds no GPU: choose benchmark=cost, which measures on a CPU")
    device = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    wanted = [_point(case, group, device) for group in groups]
    earlier = read_rows(Path(finished), "cost", {*IDENTITY}) if finished and Path(finished).exists() else []
    yield from earlier
    known = {tuple(row[name] for name in IDENTITY) for row in earlier}
    keep_freed_memory()
    torch.set_float32_matmul_precision("high")
    done, total = 0, sum(len(networks) * len(quantities) for _, quantities, _ in wanted)
    for this, quantities, acceleration in wanted:
        for network in networks.values():
            for quantity in quantities:
                progress(done, total)
                done += 1
                row = {"network": network.name, "size": size, "acceleration": acceleration, **vars(this)}
                row |= {"quantity": quantity, "device": device}
                if tuple(str(row[name]) for name in IDENTITY) not in known:
                    yield row | _measured(
                        network, this, quantity, acceleration, training, (seconds, most_seconds), device
                    )


def _point(case: Case, group: Mapping[str, Any], device: str) -> tuple[Case, Sequence[str], str]:
    acceleration = group.get("acceleration", "graphs") if device == "cuda" else "none"
    if unknown := set(group["quantities"]) - set(QUANTITIES):
        raise UserError(f"benchmark.groups: unknown quantity '{min(unknown)}': choose from {', '.join(QUANTITIES)}")
    sizes = {name: value for name, value in group.items() if name not in ("quantities", "acceleration")}
    if unknown := set(sizes) - set(Case.__dataclass_fields__):
        fields = ", ".join(Case.__dataclass_fields__)
        raise UserError(f"benchmark.groups: unknown field '{min(unknown)}': choose from {fields}")
    return replace(case, **sizes), group["quantities"], acceleration


def _measured(
    untrained: Untrained,
    case: Case,
    quantity: str,
    acceleration: str,
    training: TrainingParts,
    duration: tuple[float | int, float | int],
    device: str,
) -> Row:
    torch.manual_seed(_SEED)
    network, on_gpu = untrained(device), device == "cuda"
    if case.resolution % network.patch_size:
        raise UserError(
            f"resolution {case.resolution} does not divide into {untrained.name}'s patches of {network.patch_size}"
        )
    if on_gpu:
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    batch = case.batch(network.gbuffer_channels, _SEED)
    flops = _flops(untrained("meta"), batch.to("meta"), quantity)
    with torch.autocast(device, torch.bfloat16):
        batch = (batch if acceleration == "none" else batch.padded()).to(device)
        if quantity == "training_step":
            run = _training_step(network, batch, training, acceleration, device)
        else:
            run = _stage(network, batch, quantity, acceleration)
        try:
            row = _timed(run, *duration, on_gpu)
        except torch.OutOfMemoryError:
            return {"status": "out of memory"}
    peak = published_peak(torch.device(device), torch.bfloat16)
    return {
        **row,
        "peak_GB": torch.cuda.max_memory_allocated() / 1e9 if on_gpu else None,
        "TFLOP": flops / 1e12,
        "of_peak": flops / row["seconds"] / peak if peak else None,
        "parameters": sum(p.numel() for p in network.parameters()),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }


def _timed(run: Callable[[], Any], seconds: float | int, most_seconds: float | int, on_gpu: bool) -> Row:
    """Execute a round repeatedly. The first rounds warm up, and count only if they took long."""
    wait = torch.cuda.synchronize if on_gpu else (lambda: None)

    def round_seconds() -> tuple[float, float]:
        begin = time.perf_counter()
        run()
        launched = time.perf_counter() - begin
        wait()
        return launched, time.perf_counter() - begin

    warming = [round_seconds()]
    rounds = warming[:] if warming[0][1] >= most_seconds else []
    if not rounds and on_gpu:  # the graph is captured in the second round
        warming += [round_seconds(), round_seconds()]

    def spent() -> float:
        return sum((whole for _, whole in rounds), 0.0)

    while spent() < seconds or (len(rounds) < _LEAST_ROUNDS and spent() < most_seconds):
        rounds.append(round_seconds())
    times = [whole for _, whole in rounds]
    kernels, busy = _kernels(run) if on_gpu else (None, None)
    return {
        "status": "ok",
        "rounds": len(times),
        "seconds": median(times),
        "seconds_min": min(times),
        "host_seconds": median(launched for launched, _ in rounds) if on_gpu else None,
        "first_seconds": sum(whole for _, whole in warming),
        "kernels": kernels,
        "busy": busy and busy / median(times),
    }


def _training_step(
    network: RenderFormerPP, batch: RaggedBatch, training: TrainingParts, acceleration: str, device: str
) -> Callable[[], Any]:
    network.train()
    loss, optimizer = training.loss.to(device), training.optimizer(decay_groups(network))
    step = PlainStep() if acceleration == "none" else CapturedStep()
    if acceleration == "compiled":
        compile_blocks(network)

    def run() -> None:
        terms, _ = step(network, loss, batch)
        optimizer.zero_grad()
        terms["loss"].backward()
        nn.utils.clip_grad_norm_(network.parameters(), training.gradient_clip)
        optimizer.step()

    return run


def _stage(network: RenderFormerPP, batch: RaggedBatch, quantity: str, acceleration: str) -> Callable[[], Any]:
    convert_blocks(network.eval(), torch.bfloat16)
    stages = network if acceleration == "none" else CapturedStages(network)
    with torch.inference_mode():
        scenes = stages.encode(batch) if quantity == "view" else None

    @torch.inference_mode()
    def run() -> None:
        if quantity == "encode":
            stages.encode(batch)
        else:
            stages.view(scenes, batch.c2w, batch.fov, batch.gbuffer)

    return run


@torch.no_grad()
def _flops(network: RenderFormerPP, batch: RaggedBatch, quantity: str) -> float:
    if quantity == "training_step":
        return training_flops(network, batch)
    with FlopCounterMode(display=False) as encode:
        scenes = network.encode(batch)
    with FlopCounterMode(display=False) as view:
        network.view(scenes, batch.c2w, batch.fov, batch.gbuffer)
    return float((encode if quantity == "encode" else view).get_total_flops())


def _kernels(run: Callable[[], Any]) -> tuple[int, float]:
    """Return the number of kernels that one execution launches, and the seconds in which they run."""
    with profile(activities=[ProfilerActivity.CUDA]) as profiled:
        run()
        torch.cuda.synchronize()
    kernels = [event for event in profiled.events() if event.device_type == DeviceType.CUDA]
    return len(kernels), sum(event.device_time for event in kernels) / 1e6

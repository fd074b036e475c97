"""Time, kernels and memory of training steps and pictures on a GPU, as `launch/train.py` and the renderer run them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import nn
from torch.autograd import DeviceType
from torch.optim import Optimizer
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from rfpp.batch import RaggedBatch
from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.tasks import Untrained
from rfpp.benchmark.csv_rows import Row, read_rows
from rfpp.errors import UserError
from rfpp.inference.captured import CapturedStages
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.layers.matrix_precision import convert_blocks
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.training.blocks import compile_blocks
from rfpp.training.flops import published_peak, training_flops
from rfpp.training.module import decay_groups
from rfpp.training.steps import CapturedStep, PlainStep

#: Columns that identify a row.
IDENTITY = ("network", "size", "quantity", "acceleration", *Case.__dataclass_fields__)

_SEED = 0


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
    seconds: float,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row for each quantity of each group and network, the baseline first.

    `training_step` is forward, loss, backward, clipping and optimizer; `encode` and `view` are the stages of a picture.
    `seconds` is the median over repetitions, `host_seconds` what the host needs to launch one, `kernels` their number,
    `busy` the share of the time in which a kernel runs, `of_peak` the rate of the counted operations as a share of the
    card's published rate (MFU), `peak_GB` the maximum that tensors took.

    Args:
        groups: Changes of the case, with `acceleration` (`rfpp.training.plan.ACCELERATIONS`) and `quantities`.
        seconds: Duration of the repetitions of a row.
        finished: Table whose rows are kept and not measured again.

    Raises:
        UserError: Without a GPU, or if `finished` is not such a table.
    """
    if not torch.cuda.is_available():
        raise UserError("benchmark=gpu: PyTorch finds no GPU: benchmark=cost measures on a CPU")
    torch.set_float32_matmul_precision("high")
    earlier = read_rows(Path(finished), "gpu", {*IDENTITY}) if finished and Path(finished).exists() else []
    yield from earlier
    known = {tuple(row[name] for name in IDENTITY) for row in earlier}
    done, total = 0, len(groups) * len(networks)
    for group in groups:
        sizes = {name: value for name, value in group.items() if name in Case.__dataclass_fields__}
        this, acceleration = replace(case, **sizes), group.get("acceleration", "graphs")
        for network in networks.values():
            progress(done, total)
            done += 1
            identity = {"network": network.name, "size": size, "acceleration": acceleration, **vars(this)}
            for quantity in group["quantities"]:
                row = {**identity, "quantity": quantity}
                if tuple(str(row[name]) for name in IDENTITY) not in known:
                    yield row | _measured(network, this, quantity, acceleration, training, seconds)


def _measured(
    untrained: Untrained, case: Case, quantity: str, acceleration: str, training: TrainingParts, seconds: float
) -> Row:
    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats()
    torch.manual_seed(_SEED)
    network = untrained("cuda")
    batch = case.batch(network.gbuffer_channels, _SEED)
    flops = _flops(untrained("meta"), batch.to("meta"), quantity)
    with torch.autocast("cuda", torch.bfloat16):
        batch = (batch if acceleration == "none" else batch.padded()).to("cuda")
        if quantity == "training_step":
            run = _training_step(network, batch, training, acceleration)
        else:
            run = _stage(network, batch, quantity, acceleration)
        begin = time.perf_counter()
        try:
            for _ in range(3):
                run()
            torch.cuda.synchronize()
        except torch.OutOfMemoryError:
            return {"status": "out of memory"}
        first = time.perf_counter() - begin
        times, host = [], []
        while sum(times) < seconds or len(times) < 5:
            begin = time.perf_counter()
            run()
            host.append(time.perf_counter() - begin)
            torch.cuda.synchronize()
            times.append(time.perf_counter() - begin)
        kernels, busy = _kernels(run)
    peak = published_peak(torch.device("cuda"), torch.bfloat16)
    return {
        "status": "ok",
        "rounds": len(times),
        "seconds": median(times),
        "seconds_min": min(times),
        "host_seconds": median(host),
        "first_seconds": first,
        "kernels": kernels,
        "busy": busy / median(times),
        "peak_GB": torch.cuda.max_memory_allocated() / 1e9,
        "TFLOP": flops / 1e12,
        "of_peak": flops / median(times) / peak if peak else None,
        "parameters": sum(p.numel() for p in network.parameters()),
        "device": "cuda",
        "torch": torch.__version__,
    }


def _training_step(
    network: RenderFormerPP, batch: RaggedBatch, training: TrainingParts, acceleration: str
) -> Callable[[], Any]:
    network.train()
    loss, optimizer = training.loss.to("cuda"), training.optimizer(decay_groups(network))
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
        scenes = stages.encode(batch)

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

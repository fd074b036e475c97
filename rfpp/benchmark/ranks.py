"""Training steps of two processes on this machine, a core each: timed with and without communication."""

from __future__ import annotations

import socket
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

import torch
import torch.distributed as dist
from torch import multiprocessing, nn
from torch.nn.parallel import DistributedDataParallel

from rfpp.batch import RaggedBatch, SceneViews

if TYPE_CHECKING:
    from rfpp.benchmark.scaling import Training

RANKS = 2
#: Steps on other scenes that are timed together.
STEPS = 2


@dataclass(frozen=True)
class Timings:
    """Seconds, medians over rounds in which all take turns.

    Attributes:
        alone: a step on a global batch by one process while the other rests.
        whole_batch, half_batch: a step on a global batch, and on half of one, while the other process does the same.
        all_reduce: averaging the gradients, and nothing else.
        together: a step of both on one global batch, half each, as DistributedDataParallel does it.
    """

    alone: float
    whole_batch: float
    half_batch: float
    all_reduce: float
    together: float


def timed_ranks(
    training: Training, scenes: Sequence[SceneViews], rounds: int, progress: Callable[[int, int], None]
) -> Timings:
    """Time both processes. Of each measurement the slower one counts; `scenes` hold STEPS global batches."""
    context = multiprocessing.get_context("spawn")
    results = context.SimpleQueue()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    ranks = multiprocessing.spawn(_rank, (address, training, list(scenes), rounds, results), nprocs=RANKS, join=False)
    measured = []
    progress(0, rounds)
    while len(measured) < rounds:
        if results.empty():
            ranks.join(timeout=0.2)  # raises what a rank has raised
            continue
        measured.append(results.get())
        progress(len(measured), rounds)
    ranks.join()
    return Timings(*(median(values) for values in zip(*measured, strict=True)))


def _rank(rank: int, address: str, training: Training, scenes: list[SceneViews], rounds: int, results) -> None:
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message="Grad strides do not match")
    torch.manual_seed(0)
    dist.init_process_group("gloo", init_method=address, rank=rank, world_size=RANKS)
    network, loss = training.network(), training.loss()
    together = DistributedDataParallel(network)
    optimizer = training.optimizer(network.parameters())
    whole = [RaggedBatch.pack(scenes[i * training.scenes :][: training.scenes]) for i in range(STEPS)]
    share = training.scenes // RANKS
    half = [RaggedBatch.pack(scenes[i * training.scenes + rank * share :][:share]) for i in range(STEPS)]
    gradients = torch.zeros(sum(p.numel() for p in network.parameters()))

    def steps(module: nn.Module, batches: Sequence[RaggedBatch]) -> None:
        for batch in batches:
            with torch.autocast("cpu", torch.bfloat16):
                made = module(batch)
            loss(made.log_radiance, made.transport_states, batch.image, made.token_segments)["loss"].backward()
            optimizer.step()
            optimizer.zero_grad()

    measurements: Sequence[Callable[[], None]] = (
        lambda: steps(network, whole) if rank == 0 else None,
        lambda: steps(network, whole),
        lambda: steps(network, half),
        lambda: [dist.all_reduce(gradients) for _ in range(STEPS)],
        lambda: steps(together, half),
    )
    for turn in range(-1, rounds):  # the first one warms up
        seconds = torch.tensor([_seconds(run) / STEPS for run in measurements])
        dist.all_reduce(seconds, dist.ReduceOp.MAX)
        if rank == 0 and turn >= 0:
            results.put(seconds.tolist())
    dist.destroy_process_group()


def _seconds(run: Callable[[], None]) -> float:
    dist.barrier()
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin

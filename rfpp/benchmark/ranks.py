"""Time training steps of two processes on this machine, with and without communication."""

from __future__ import annotations

import socket
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median

import torch
import torch.distributed as dist
from torch import multiprocessing, nn
from torch.nn.parallel import DistributedDataParallel

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.benchmark.training_case import Training
from rfpp.training.dealing import Dealing, InOrder

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
        together: a step of both on one global batch, half each, as DistributedDataParallel does it, by dealing.
    """

    alone: float
    whole_batch: float
    half_batch: float
    all_reduce: float
    together: dict[str, float]


def timed_ranks(
    training: Training,
    scenes: Sequence[SceneViews],
    dealings: Mapping[str, Dealing],
    rounds: int,
    progress: Callable[[int, int], None],
) -> Timings:
    """Time both processes. Of each measurement the slower one counts; `scenes` hold STEPS global batches."""
    context = multiprocessing.get_context("spawn")
    results = context.SimpleQueue()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    arguments = (address, training, list(scenes), list(dealings.values()), rounds, results)
    ranks = multiprocessing.spawn(_rank, arguments, nprocs=RANKS, join=False)
    measured = []
    progress(0, rounds)
    while len(measured) < rounds:
        if results.empty():
            ranks.join(timeout=0.2)  # raises what a rank has raised
            continue
        measured.append(results.get())
        progress(len(measured), rounds)
    ranks.join()
    alone, whole_batch, half_batch, all_reduce, *together = (median(values) for values in zip(*measured, strict=True))
    return Timings(alone, whole_batch, half_batch, all_reduce, dict(zip(dealings, together, strict=True)))


def _rank(
    rank: int,
    address: str,
    training: Training,
    scenes: list[SceneViews],
    dealings: Sequence[Dealing],
    rounds: int,
    results,
) -> None:
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message="Grad strides do not match")
    torch.manual_seed(0)
    dist.init_process_group("gloo", init_method=address, rank=rank, world_size=RANKS)
    network, loss = training.network(), training.loss()
    together = DistributedDataParallel(network)
    optimizer = training.optimizer(network.parameters())
    batches = [scenes[i * training.scenes :][: training.scenes] for i in range(STEPS)]
    whole = [RaggedBatch.pack(batch) for batch in batches]

    def share(dealing: Dealing) -> list[RaggedBatch]:
        """This rank's, of each global batch."""
        return [
            RaggedBatch.pack(dealing(batch, lambda scene: len(scene.triangles.positions), RANKS)[rank])
            for batch in batches
        ]

    half, shares = share(InOrder()), [share(dealing) for dealing in dealings]
    gradients = torch.zeros(sum(p.numel() for p in network.parameters()))

    def steps(module: nn.Module, packed: Sequence[RaggedBatch]) -> None:
        for batch in packed:
            with torch.autocast("cpu", torch.bfloat16):
                made = module(batch)
            loss(made.log_radiance, made.transport_states, batch.image, made.state_segments)["loss"].backward()
            optimizer.step()
            optimizer.zero_grad()

    measurements: Sequence[Callable[[], None]] = (
        lambda: steps(network, whole) if rank == 0 else None,
        lambda: steps(network, whole),
        lambda: steps(network, half),
        lambda: [dist.all_reduce(gradients) for _ in range(STEPS)],
        *(partial(steps, together, dealt) for dealt in shares),
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

"""Time training steps of two processes on this machine, with and without communication."""

from __future__ import annotations

import socket
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

import hydra
import numpy as np
import torch
import torch.distributed as dist
from hydra.utils import instantiate
from torch import multiprocessing, nn
from torch.nn.parallel import DistributedDataParallel

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.benchmark.case import noisy_views
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.layers.matrix_precision import matrix_dtype
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import pack
from rfpp.shards.job import SceneSource
from rfpp.training.batching import Contiguous, Partition

RANKS = 2
#: Steps on different scenes that are timed together.
STEPS = 2


@dataclass(frozen=True)
class TrainingCase:
    """Experiment without its data set."""

    network: Callable[[], RenderFormerPP]
    loss: Callable[[], RenderingLoss]
    optimizer: Callable[..., torch.optim.Optimizer]
    family: SceneSource
    resolution: int
    views: int
    scenes_per_step: int
    scenes_at_once: int | None

    @classmethod
    def compose(cls, overrides: Sequence[str]) -> TrainingCase:
        """Return the training of launch/train.py with these overrides; needs an initialized Hydra."""
        cfg = hydra.compose("train", overrides=list(overrides))
        return cls(
            network=partial(instantiate, cfg.model, _convert_="all"),
            loss=partial(instantiate, cfg.loss),
            optimizer=instantiate(cfg.optimizer),
            family=instantiate(cfg.family, _convert_="all"),
            resolution=cfg.data.resolution,
            views=cfg.datamodule.batching.views_per_scene,
            scenes_per_step=cfg.datamodule.batching.scenes_per_step,
            scenes_at_once=cfg.datamodule.batching.scenes_per_device,
        )

    def scenes(self, count: int) -> list[SceneViews]:
        """Draw scenes of the family; images and G-buffers are noise."""
        channels, scenes = self.network().gbuffer_channels, []
        for seed in range(count):
            rng = np.random.default_rng(seed)
            scene = pack(self.family.sample(*rng.spawn(2), held_out=False))
            scene = scene.views([i % len(scene.fov) for i in range(self.views)])
            scenes.append(noisy_views(scene.triangles, scene.c2w, scene.fov, channels, self.resolution, rng))
        return scenes


@dataclass(frozen=True)
class Timings:
    """Seconds per step; medians over rounds in which all measurements take turns.

    Attributes:
        alone: Step on a global batch by one process while the other is idle.
        whole_batch, half_batch: Step on a global batch, and on half of one, while the other process does the same.
        together: Partition → step of both processes on a global batch, half each, with DistributedDataParallel.
    """

    alone: float
    whole_batch: float
    half_batch: float
    all_reduce: float
    together: dict[str, float]


def as_trained() -> torch.autocast:
    """Return a context with the precision of `trainer.precision=auto` on this machine's CPU."""
    dtype = matrix_dtype("auto", torch.device("cpu"))
    return torch.autocast("cpu", dtype, enabled=dtype != torch.float32)


def time_ranks(
    training: TrainingCase,
    scenes: Sequence[SceneViews],
    partitions: Mapping[str, Partition],
    rounds: int,
    progress: Callable[[int, int], None],
) -> Timings:
    """Time both processes on the first STEPS global batches; the slower one counts."""
    context = multiprocessing.get_context("spawn")
    results = context.SimpleQueue()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    arguments = (address, training, list(scenes), list(partitions.values()), rounds, results)
    ranks = multiprocessing.spawn(_rank, arguments, nprocs=RANKS, join=False)
    measured = []
    progress(0, rounds)
    while len(measured) < rounds:
        if results.empty():
            ranks.join(timeout=0.2)  # raises the exceptions of the ranks
            continue
        measured.append(results.get())
        progress(len(measured), rounds)
    ranks.join()
    alone, whole_batch, half_batch, all_reduce, *together = (median(values) for values in zip(*measured, strict=True))
    return Timings(alone, whole_batch, half_batch, all_reduce, dict(zip(partitions, together, strict=True)))


def _rank(
    rank: int,
    address: str,
    training: TrainingCase,
    scenes: list[SceneViews],
    partitions: Sequence[Partition],
    rounds: int,
    results: Any,  # queue of one list of seconds per round
) -> None:
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message="Grad strides do not match")
    torch.manual_seed(0)
    dist.init_process_group("gloo", init_method=address, rank=rank, world_size=RANKS)
    network, loss = training.network(), training.loss()
    parallel = DistributedDataParallel(network)
    optimizer = training.optimizer(network.parameters())
    batches = [scenes[i * training.scenes_per_step :][: training.scenes_per_step] for i in range(STEPS)]

    def share(partition: Partition) -> list[RaggedBatch]:
        """Return this rank's part of each global batch."""
        parts = [partition(batch, lambda scene: len(scene.triangles), RANKS)[rank] for batch in batches]
        return [RaggedBatch.pack(part) for part in parts]

    def train(module: nn.Module, packed: Sequence[RaggedBatch]) -> None:
        for batch in packed:
            with as_trained():
                rendering = module(batch)
            states, segments = rendering.transport_states, rendering.token_segments
            loss(rendering.log_radiance, states, batch.image, segments)["loss"].backward()
            optimizer.step()
            optimizer.zero_grad()

    whole, half = [RaggedBatch.pack(batch) for batch in batches], share(Contiguous())
    gradients = torch.zeros(sum(p.numel() for p in network.parameters()))
    measurements: Sequence[Callable[[], object]] = (
        lambda: train(network, whole) if rank == 0 else None,
        lambda: train(network, whole),
        lambda: train(network, half),
        lambda: [dist.all_reduce(gradients) for _ in range(STEPS)],
        *(partial(train, parallel, share(partition)) for partition in partitions),
    )
    for turn in range(-1, rounds):  # the first one warms up
        seconds = torch.tensor([_seconds(run) / STEPS for run in measurements])
        dist.all_reduce(seconds, dist.ReduceOp.MAX)
        if rank == 0 and turn >= 0:
            results.put(seconds.tolist())
    dist.destroy_process_group()


def _seconds(run: Callable[[], object]) -> float:
    dist.barrier()
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin

"""How training scales: the model of a step's time, checked with two processes on this machine, asked about GPUs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
import torch
from hydra import compose
from hydra.utils import instantiate
from scipy.optimize import nnls

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.benchmark.cost.case import noise
from rfpp.benchmark.ranks import Timings, timed_ranks
from rfpp.benchmark.step_time import Cluster, Work, step_time
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import pack
from rfpp.shards.job import SceneSource
from rfpp.training.dealing import Dealing
from rfpp.training.flops import training_flops

Row = dict[str, str | int | float | None]

#: Of the sampled scenes so many have their operations counted; the others' lie on a line over triangles.
COUNTED = 3


@dataclass(frozen=True)
class Training:
    """What is trained, and on what: an experiment without its data set.

    Attributes:
        network, loss, optimizer: makers of each, the last from parameters.
        family: of scenes, whose triangles are all that matters.
        resolution, views: of a scene's images.
        scenes, scenes_at_once: of a global batch, and what a device holds of it (None: its whole share).
        sample: how many scenes stand for the family; at least twice a global batch where steps are timed.
    """

    network: Callable[[], RenderFormerPP]
    loss: Callable[[], RenderingLoss]
    optimizer: Callable[..., torch.optim.Optimizer]
    family: SceneSource
    resolution: int
    views: int
    scenes: int
    scenes_at_once: int | None
    sample: int

    @classmethod
    def of(cls, overrides: Sequence[str], sample: int) -> Training:
        """What launch/train.py would train, given these overrides. To be called in a Hydra application."""
        cfg = compose("train", overrides=list(overrides))
        return cls(
            network=partial(instantiate, cfg.model, _convert_="all"),
            loss=partial(instantiate, cfg.loss),
            optimizer=instantiate(cfg.optimizer),
            family=instantiate(cfg.scene, _convert_="all"),
            resolution=cfg.data.resolution,
            views=cfg.datamodule.views_per_scene,
            scenes=cfg.datamodule.scenes_per_step,
            scenes_at_once=cfg.datamodule.scenes_per_device,
            sample=sample,
        )

    def scene_views(self) -> list[SceneViews]:
        """The family's first scenes, with noise for images and G-buffers."""
        channels = self.network().gbuffer_channels
        return [self._noisy(np.random.default_rng(i), channels) for i in range(self.sample)]

    def _noisy(self, rng: np.random.Generator, channels: Sequence[str]) -> SceneViews:
        scene = pack(self.family.sample(*rng.spawn(2), held_out=False))
        scene = scene.views([i % len(scene.fov) for i in range(self.views)])
        invented = noise(channels, scene.triangles.num_objects, self.views, self.resolution, rng)
        return SceneViews("", scene.triangles, scene.c2w, scene.fov, **invented)

    def work(self, scenes: Sequence[SceneViews], dealing: Dealing) -> Work:
        """Of a step on these scenes."""
        network = self.network()
        triangles = np.array([len(s.triangles.positions) for s in scenes])
        counted = np.argsort(triangles)[np.linspace(0, len(scenes) - 1, COUNTED).astype(int)]
        with torch.autocast("cpu", torch.bfloat16):
            flops = [training_flops(network, RaggedBatch.pack([scenes[i]])) for i in counted]
        line = np.polynomial.Polynomial.fit(triangles[counted], flops, 1)
        size = float(sum(p.numel() * p.element_size() for p in network.parameters()))
        return Work(triangles, line(triangles), size, self.scenes, self.scenes_at_once, dealing, self.views)


def measure(
    checked: Sequence[str],
    predicted: Sequence[str],
    sample: int,
    dealings: Mapping[str, Dealing],
    clusters: Mapping[str, Cluster],
    devices: Sequence[int],
    rounds: int,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """Rows of this machine, one and two processes of a core each, and of the clusters, by dealing and devices.

    Of this machine are known: the time of a step without communication for half and for a whole global batch while
    both cores work, and of averaging the gradients alone. The time of two processes' steps is predicted from these,
    and measured.

    Args:
        checked: overrides of launch/train.py; small enough to be timed here.
        predicted: overrides, too: what the clusters train, with its global batch and with one that grows with them.
        sample: how many scenes stand for all.
        dealings: of a global batch to devices, by the name that the rows have.
        clusters: likewise.
        devices: how many.
        rounds: of timing; medians are taken.
        progress: called with (rounds done, rounds in all).
    """
    training = Training.of(checked, sample)
    scenes = training.scene_views()
    timings = timed_ranks(training, scenes, dealings, rounds, progress)
    some_dealing = next(iter(dealings.values()))
    work = training.work(scenes, some_dealing)
    here = this_machine(work, timings)
    rows = []
    for name, dealing in dealings.items():
        measured = {1: timings.alone, 2: timings.together[name]}
        dealt = replace(work, dealing=dealing)
        rows += _rows("this machine", name, here, dict.fromkeys(measured, dealt), measured)
    training = Training.of(predicted, sample)
    work = training.work(training.scene_views(), some_dealing)
    for (hardware, cluster), (name, dealing) in product(clusters.items(), dealings.items()):
        dealt = replace(work, dealing=dealing)
        per_device = max(1, work.scenes // cluster.devices_per_node)
        rows += _rows(hardware, name, cluster, {n: dealt for n in devices if work.scenes % n == 0})
        rows += _rows(hardware, name, cluster, {n: replace(dealt, scenes=per_device * n) for n in devices})
    return rows


def this_machine(work: Work, timings: Timings) -> Cluster:
    """Two processes, one on each of two cores, which communicate on the same cores."""
    times = [timings.whole_batch, timings.half_batch]
    (per_batch, per_scene), _ = nnls([[1, work.scenes], [1, work.scenes / 2]], times)
    return Cluster(
        devices_per_node=2,
        flops_per_second=float(work.scene_flops.mean() / per_scene),
        seconds_per_batch=float(per_batch),
        device_bandwidth=work.gradient_bytes / timings.all_reduce,
        node_bandwidth=float("inf"),
        latency=0.0,
        bucket_bytes=0.0,
        overlap=0.0,
        images_per_second=float("inf"),
    )


def _rows(
    hardware: str,
    dealing: str,
    cluster: Cluster,
    work: Mapping[int, Work],
    measured: Mapping[int, float] | None = None,
) -> list[Row]:
    """A row for each number of devices, the first of them the one that the others' efficiency is of."""
    times = {devices: step_time(cluster, its, devices) for devices, its in work.items()}
    rates = {devices: its.images / times[devices].total for devices, its in work.items()}
    first = next(iter(work))
    return [
        {
            "trained_on": hardware,
            "dealt": dealing,
            "devices": devices,
            "images_per_step": work[devices].images,
            "compute_s": time.compute,
            "waiting_s": time.waiting,
            "communication_s": time.communication,
            "data_s": time.data,
            "step_s": time.total,
            "measured_s": None if measured is None else measured[devices],
            "images_per_s": rates[devices],
            "efficiency": (rates[devices] / devices) / (rates[first] / first),
        }
        for devices, time in times.items()
    ]

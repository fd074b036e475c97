"""Predict training time on clusters with a model that is checked with two processes on this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import nnls

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.ranks import Timings, TrainingCase, as_trained, time_ranks
from rfpp.benchmark.step_time import Cluster, Work, step_time
from rfpp.ranges import Positive
from rfpp.training.batching import Partition
from rfpp.training.flops import training_flops

#: Scenes whose operations are counted; those of the others are linear in the number of triangles.
COUNTED = 3


def measure(
    checked: Sequence[str],
    predicted: Sequence[str],
    sample: Positive,
    partitions: Mapping[str, Partition],
    clusters: Mapping[str, Cluster],
    devices: Sequence[Positive],
    rounds: Positive,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield rows of one and two processes on this machine, then of the clusters, by partition and devices.

    On this machine, three times are measured: of a step without communication on half and on a whole global batch
    while both cores are busy, and of averaging the gradients alone. The model predicts the time of a step of two
    processes from these; that time is measured, too.
    """
    training = TrainingCase.compose(checked)
    scenes = training.scenes(sample)
    timings = time_ranks(training, scenes, partitions, rounds, progress)
    work = _work(training, scenes, next(iter(partitions.values())))
    here = this_machine(work, timings)
    for name, partition in partitions.items():
        measured = {1: timings.alone, 2: timings.together[name]}
        works = dict.fromkeys(measured, replace(work, partition=partition))
        yield from _rows({"trained_on": "this machine", "partition": name}, here, works, measured)
    training = TrainingCase.compose(predicted)
    work = _work(training, training.scenes(sample), next(iter(partitions.values())))
    for (hardware, cluster), (name, partition) in product(clusters.items(), partitions.items()):
        columns, own = {"trained_on": hardware, "partition": name}, replace(work, partition=partition)
        per_device = max(1, work.scenes // cluster.devices_per_node)
        yield from _rows(columns, cluster, {n: own for n in devices if work.scenes % n == 0}, {})
        yield from _rows(columns, cluster, {n: replace(own, scenes=per_device * n) for n in devices}, {})


def _work(training: TrainingCase, scenes: Sequence[SceneViews], partition: Partition) -> Work:
    network = training.network()
    triangles = np.array([len(scene.triangles) for scene in scenes])
    counted = np.argsort(triangles)[np.linspace(0, len(scenes) - 1, COUNTED).astype(int)]
    with as_trained():
        flops = [training_flops(network, RaggedBatch.pack([scenes[i]])) for i in counted]
    line = np.polynomial.Polynomial.fit(triangles[counted], flops, 1)
    size = float(sum(p.numel() * p.element_size() for p in network.parameters()))
    return Work(
        triangles, line(triangles), size, training.scenes_per_step, training.scenes_at_once, partition, training.views
    )


def this_machine(work: Work, timings: Timings) -> Cluster:
    """Fit the model to two processes on a core each, which compute and communicate on the same cores."""
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
    columns: Mapping[str, str], cluster: Cluster, works: Mapping[int, Work], measured: Mapping[int, float]
) -> Iterator[Row]:
    """Yield a row for each number of devices; `efficiency` compares with the first one."""
    first = None
    for devices, work in works.items():
        time = step_time(cluster, work, devices)
        rate = work.images / time.total
        first = first or rate / devices
        yield {
            **columns,
            "devices": devices,
            "images_per_step": work.images,
            "compute_s": time.compute,
            "waiting_s": time.waiting,
            "communication_s": time.communication,
            "data_s": time.data,
            "step_s": time.total,
            "measured_s": measured.get(devices),
            "images_per_s": rate,
            "efficiency": rate / devices / first,
        }

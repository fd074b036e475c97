"""Predict training time on clusters with a model checked on this machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product

from scipy.optimize import nnls

from rfpp.benchmark.ranks import Timings, timed_ranks
from rfpp.benchmark.step_time import Cluster, Work, step_time
from rfpp.benchmark.training_case import Training
from rfpp.training.dealing import Dealing

Row = dict[str, str | int | float | None]


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

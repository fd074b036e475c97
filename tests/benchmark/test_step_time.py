"""The model of the time of a training step, in cases with known answers."""

from dataclasses import replace

import numpy as np
import pytest

from rfpp.benchmark.step_time import BACKWARD_SHARE, Cluster, Work, all_reduce_seconds, slowest_share, step_time
from rfpp.training.batching import BalancedBySize, Contiguous, Partition

WORK = Work(
    triangles=np.full(10, 100), scene_flops=np.full(10, 3e12), gradient_bytes=8e8, scenes=16, scenes_at_once=None,
    partition=Contiguous(), views=2,
)  # fmt: skip
CLUSTER = Cluster(
    devices_per_node=8, flops_per_second=1e12, seconds_per_batch=0.5, device_bandwidth=1e11, node_bandwidth=1e10,
    latency=0.0, bucket_bytes=0.0, overlap=0.0, images_per_second=100.0,
)  # fmt: skip


def relative_load(sizes: np.ndarray, devices: int, share: int, partition: Partition) -> float:
    """Return the load of the slowest device, with operations proportional to triangles."""
    work = replace(WORK, triangles=sizes, scene_flops=sizes.astype(float), scenes=devices * share, partition=partition)
    return slowest_share(work, devices)


@pytest.mark.parametrize("partition", [Contiguous(), BalancedBySize()])
def test_the_slowest_of_two_devices_has_the_expected_maximum(partition):
    """One scene each, 1 or 3 with even chances: the maximum's mean is 2.5 where the mean is 2."""
    assert relative_load(np.array([1, 3]), 2, 1, partition) == pytest.approx(1.25, abs=0.02)


def test_partition_by_size_leaves_the_indivisible_rest():
    """Two scenes each, 1 or 3 with even chances: an odd number of large ones, every other time, is 1 over the mean."""
    assert relative_load(np.array([1, 3]), 2, 2, BalancedBySize()) == pytest.approx(4.5 / 4, abs=0.02)
    assert relative_load(np.array([1, 3]), 2, 2, Contiguous()) == pytest.approx(4.75 / 4, abs=0.02)


def test_a_ring_moves_each_byte_nearly_twice():
    """2 (n - 1) / n of the bytes pass each device: Patarasuk and Yuan 2009."""
    assert all_reduce_seconds(CLUSTER, 8e8, 1) == 0
    assert all_reduce_seconds(CLUSTER, 8e8, 2) == pytest.approx(8e8 / 1e11)
    assert all_reduce_seconds(CLUSTER, 8e8, 8) == pytest.approx(2 * 7 / 8 * 8e8 / 1e11)


def test_communication_overlaps_with_the_backward_pass_except_for_the_last_bucket():
    slow = replace(CLUSTER, device_bandwidth=1e8)
    alone = step_time(slow, WORK, 2).communication
    assert alone == pytest.approx(8.0)
    backward = BACKWARD_SHARE * 8 * 3
    assert step_time(replace(slow, overlap=0.25), WORK, 2).communication == pytest.approx(alone - 0.25 * backward)
    hidden = replace(slow, overlap=1.0, bucket_bytes=1e8)
    assert step_time(hidden, WORK, 2).communication == pytest.approx(1.0)
    # only the last of eight batches has its gradients averaged
    held = replace(WORK, scenes_at_once=1)
    assert step_time(replace(slow, overlap=1.0), held, 2).communication == pytest.approx(alone - backward / 8)

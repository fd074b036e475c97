"""Model of the time of a training step on several devices.

Synchronous data parallelism: the devices share a global batch, the slowest one decides, and their gradients are
averaged by all-reduces that overlap with the backward pass (Li et al. 2020, "PyTorch Distributed"). Scenes differ in
size, so the devices' shares do too, depending on the partition of the batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from rfpp.training.batching import Partition

#: Share of the backward pass, which produces the gradients, in forward and backward.
BACKWARD_SHARE = 2 / 3
#: Random global batches over which the slowest device is averaged.
DRAWS = 2000


@dataclass(frozen=True)
class Cluster:
    """Properties of a cluster that decide the time of a step.

    Attributes:
        devices_per_node: Maximum number of devices in a node.
        flops_per_second: Rate of one device in training.
        seconds_per_batch: Fixed time per batch and device, e.g. kernel launches and the optimizer.
        device_bandwidth: Bytes per second into and out of a device within its node.
        node_bandwidth: Bytes per second into and out of a node, over all its network cards.
        bucket_bytes: Gradients that are averaged together; the last bucket does not overlap with the backward pass.
        overlap: Share of the backward pass with which communication can overlap; 0 on the same cores.
        images_per_second: Images that a device's loader processes decode.
    """

    devices_per_node: int
    flops_per_second: float
    seconds_per_batch: float
    device_bandwidth: float
    node_bandwidth: float
    latency: float
    bucket_bytes: float
    overlap: float
    images_per_second: float


@dataclass(frozen=True)
class Work:
    """Work of a training step.

    Attributes:
        triangles: Triangles of sampled scenes.
        scene_flops: Operations of a training step on each of these scenes, with all its views.
        gradient_bytes: Size of the network's gradients.
        scenes: Scenes in a global batch.
        scenes_at_once: Scenes that a device holds, the rest being accumulated; None for its whole share.
        partition: Distribution of a global batch over devices.
        views: Views of each scene.
    """

    triangles: Int[np.ndarray, " sample"]
    scene_flops: Float[np.ndarray, " sample"]
    gradient_bytes: float
    scenes: int
    scenes_at_once: int | None
    partition: Partition
    views: int

    @property
    def images(self) -> int:
        """Images in a global batch."""
        return self.scenes * self.views


@dataclass(frozen=True)
class StepTime:
    """Seconds of a step.

    Attributes:
        compute: Computation of an average device.
        waiting: Additional time of the device with the largest scenes.
        communication: Part of the all-reduce that does not overlap with the backward pass.
        data: Loading of the next batch, in parallel with all of the above.
    """

    compute: float
    waiting: float
    communication: float
    data: float

    @property
    def total(self) -> float:
        """Seconds of the whole step."""
        return max(self.compute + self.waiting + self.communication, self.data)


def step_time(cluster: Cluster, work: Work, devices: int) -> StepTime:
    """Predict the time of a step. Raises ValueError if the global batch does not divide among the devices."""
    share, left = divmod(work.scenes, devices)
    if left or not share:
        raise ValueError(f"{work.scenes} scenes do not divide among {devices} devices")
    batches = -(-share // (work.scenes_at_once or share))
    mean = share * work.scene_flops.mean() / cluster.flops_per_second
    backward = BACKWARD_SHARE * mean / batches  # only the last batch's gradients are averaged
    all_reduce = all_reduce_seconds(cluster, work.gradient_bytes, devices)
    last_bucket = all_reduce_seconds(cluster, min(cluster.bucket_bytes, work.gradient_bytes), devices)
    return StepTime(
        compute=mean + batches * cluster.seconds_per_batch,
        waiting=(slowest_share(work, devices) - 1) * mean,
        communication=max(all_reduce - cluster.overlap * backward, last_bucket),
        data=share * work.views / cluster.images_per_second,
    )


def slowest_share(work: Work, devices: int) -> float:
    """Return the largest load of a device divided by the mean load, averaged over random batches."""
    drawn = np.random.default_rng(0).integers(len(work.triangles), size=(DRAWS, work.scenes))
    parts = [work.partition(batch, work.triangles.__getitem__, devices) for batch in drawn.tolist()]
    loads = work.scene_flops[np.array(parts)].sum(-1)  # [draws, devices]
    return float(loads.max(-1).mean() / loads.mean())


def all_reduce_seconds(cluster: Cluster, size: float, devices: int) -> float:
    """Predict an all-reduce: a ring within each node, then one between nodes, in which each device moves its part."""
    within = min(devices, cluster.devices_per_node)
    nodes = -(-devices // cluster.devices_per_node)

    def ring(members: int, bandwidth: float) -> float:
        return 2 * (members - 1) * (size / members / bandwidth + cluster.latency)

    return ring(within, cluster.device_bandwidth) + ring(nodes, cluster.node_bandwidth)

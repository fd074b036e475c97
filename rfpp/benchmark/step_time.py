"""What a training step takes on so many devices: a model of it, on paper.

Synchronous data parallelism: the devices share a global batch, each computes its part, the slowest one decides, and
their gradients are averaged by all-reduces that hide behind the backward pass as far as they can (Li et al. 2020,
"PyTorch Distributed"). Scenes differ in size, so the devices' parts do too, as much as their dealing leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from rfpp.training.dealing import Dealing

#: Of forward and backward; gradients come in the latter.
BACKWARD_SHARE = 2 / 3
#: Random global batches whose slowest device is averaged over.
DRAWS = 2000


@dataclass(frozen=True)
class Cluster:
    """What of a cluster decides the time of a step.

    Attributes:
        devices_per_node: at most.
        flops_per_second: of one device, as training achieves it.
        seconds_per_batch: of one device, whatever the batch: launching, the optimizer.
        device_bandwidth: bytes per second into and out of a device, within its node.
        node_bandwidth: bytes per second into and out of a node, over all its network cards.
        latency: seconds per message.
        bucket_bytes: of gradients that are averaged together; the last bucket's communication hides behind nothing.
        overlap: share of the backward pass that communication can hide behind; 0 where it takes the same cores.
        images_per_second: that a device's loader processes decode.
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
    """What there is to do.

    Attributes:
        triangles: of a sample of scenes.
        scene_flops: of the same: operations of a training step for each, with all its views.
        gradient_bytes: of the network.
        scenes: of a global batch.
        scenes_at_once: that a device holds; the rest of its share comes after. None: its whole share.
        dealing: which device gets which scenes.
        views: of each scene.
    """

    triangles: Int[np.ndarray, " sample"]
    scene_flops: Float[np.ndarray, " sample"]
    gradient_bytes: float
    scenes: int
    scenes_at_once: int | None
    dealing: Dealing
    views: int

    @property
    def images(self) -> int:
        """Of a global batch."""
        return self.scenes * self.views


@dataclass(frozen=True)
class StepTime:
    """Seconds of a step. All but `data` add up; a step takes `data` where that is longer.

    Attributes:
        compute: of an average device.
        waiting: for the device with the largest scenes.
        communication: what of the all-reduce hides behind nothing.
        data: until the loader processes have the next batch.
    """

    compute: float
    waiting: float
    communication: float
    data: float

    @property
    def total(self) -> float:
        return max(self.compute + self.waiting + self.communication, self.data)


def step_time(cluster: Cluster, work: Work, devices: int) -> StepTime:
    """The time of a step on so many devices. Raises ValueError when the global batch does not divide among them."""
    share, left = divmod(work.scenes, devices)
    if left or not share:
        raise ValueError(f"{work.scenes} scenes do not divide among {devices} devices")
    batches = -(-share // (work.scenes_at_once or share))
    mean = share * work.scene_flops.mean() / cluster.flops_per_second
    slowest = slowest_share(work, devices) * mean
    backward = BACKWARD_SHARE * mean / batches  # only the last one's gradients are averaged
    alone = all_reduce_seconds(cluster, work.gradient_bytes, devices)
    last_bucket = all_reduce_seconds(cluster, min(cluster.bucket_bytes, work.gradient_bytes), devices)
    return StepTime(
        compute=mean + batches * cluster.seconds_per_batch,
        waiting=slowest - mean,
        communication=max(alone - cluster.overlap * backward, last_bucket),
        data=share * work.views / cluster.images_per_second,
    )


def slowest_share(work: Work, devices: int) -> float:
    """How much more than the average the device with the most to do has to do, in the mean over random batches."""
    drawn = np.random.default_rng(0).integers(len(work.triangles), size=(DRAWS, work.scenes))
    dealt = [work.dealing(batch, work.triangles.__getitem__, devices) for batch in drawn.tolist()]
    loads = work.scene_flops[np.array(dealt)].sum(-1)  # [draws, devices]
    return float(loads.max(-1).mean() / loads.mean())


def all_reduce_seconds(cluster: Cluster, size: float, devices: int) -> float:
    """Averaging so many bytes: in a ring within each node, then between nodes, every device its part."""
    within = min(devices, cluster.devices_per_node)
    nodes = -(-devices // cluster.devices_per_node)

    def ring(members: int, bandwidth: float) -> float:
        return 2 * (members - 1) * (size / members / bandwidth + cluster.latency)

    return ring(within, cluster.device_bandwidth) + ring(nodes, cluster.node_bandwidth)

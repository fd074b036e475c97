"""Sizes of global and device batches."""

from __future__ import annotations

from dataclasses import dataclass

from rfpp.errors import UserError
from rfpp.training.partition import Partition


@dataclass(frozen=True)
class Batching:
    """Division of training scenes into batches.

    Attributes:
        scenes_per_step: scenes in a global batch, over all devices.
        scenes_per_device: maximum number of scenes that a device holds at once; gradients of the remaining scenes of
            its share are accumulated. None: the whole share at once.
        views_per_scene: views drawn from each scene; scenes × views is the paper's batch size.
        partition: divides a global batch among devices.
        shuffle_shards: number of shards shuffled together.
    """

    scenes_per_step: int
    scenes_per_device: int | None
    views_per_scene: int
    partition: Partition
    shuffle_shards: int

    def accumulation(self, devices: int) -> int:
        """Return the minimum number of batches to accumulate per device and step.

        Raises:
            UserError: If the global batch does not divide among the devices.
        """
        share, remainder = divmod(self.scenes_per_step, devices)
        if remainder or not share:
            raise UserError(
                f"datamodule.batching.scenes_per_step={self.scenes_per_step} does not divide among {devices} devices "
                "(trainer.devices x trainer.num_nodes): choose a multiple"
            )
        most = share if self.scenes_per_device is None else self.scenes_per_device
        if most < 1:
            raise UserError(f"datamodule.batching.scenes_per_device={most}: use 1 or more, or null for no limit")
        return next(n for n in range(1, share + 1) if share % n == 0 and share // n <= most)

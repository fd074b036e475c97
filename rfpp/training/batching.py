"""Sizes of global and device batches, and the partition of a global batch among devices.

Any partition gives the same optimizer step: devices get equally many scenes and gradients are averaged. It only
determines how long devices wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Protocol, TypeVar, runtime_checkable

from rfpp.errors import UserError
from rfpp.ranges import Positive

Draw = TypeVar("Draw")


@runtime_checkable
class Partition(Protocol):
    """Division of draws into parts of equal length, from draws, triangle counts and the number of parts.

    Every rank computes it, so it must be deterministic. Draws keep their order within a part.
    """

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]: ...


class Contiguous:
    """Consecutive draws in each part; does not need triangle counts."""

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]:
        size = len(draws) // parts
        return [list(draws[i * size : (i + 1) * size]) for i in range(parts)]


class BalancedBySize:
    """Partition that balances the triangle counts of the parts.

    Assigns scenes from the largest to the smallest to the part with the fewest triangles that is not full (longest
    processing time first, Graham 1969). Parts are numbered by their first draws, so that no device gets the largest
    scene more often than others.

    The cost of a scene grows linearly with its triangles: within 2% of RenderFormer++'s operations at the paper's
    sizes, with equally many views per scene.
    """

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]:
        if parts == 1:
            return [list(draws)]
        triangles = [triangles_of(draw) for draw in draws]
        assigned: list[list[int]] = [[] for _ in range(parts)]
        lightest = [(0, part) for part in range(parts)]
        for position in sorted(range(len(draws)), key=triangles.__getitem__, reverse=True):
            load, part = heappop(lightest)
            assigned[part].append(position)
            if len(assigned[part]) < len(draws) // parts:
                heappush(lightest, (load + triangles[position], part))
        return [[draws[position] for position in part] for part in sorted(map(sorted, assigned))]


@dataclass(frozen=True)
class Batching:
    """Division of training scenes into batches.

    Attributes:
        scenes_per_device: maximum number of scenes that a device holds at once; gradients of the remaining scenes of
            its share are accumulated. None: the whole share at once.
        views_per_scene: views drawn from each scene; scenes × views is the paper's batch size.
    """

    scenes_per_step: Positive
    scenes_per_device: Positive | None
    views_per_scene: Positive
    partition: Partition
    shuffle_shards: Positive

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

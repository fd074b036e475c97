"""Training samples: augmented views of stored scenes, in the order of global batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice

import numpy as np
from torch.utils.data import Dataset, Sampler

from rfpp.batch import SceneViews
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.shards.views import read_views
from rfpp.training.augmentation import Augmentation
from rfpp.training.batching import Partition


class TrainingViews(Dataset):
    """Random views of a split's scenes, a pure function of (seed, epoch, scene).

    Args:
        views_per_scene: Number of views drawn from each scene without replacement.
    """

    def __init__(
        self,
        split: ShardSplit,
        channels: Sequence[str],
        views_per_scene: int,
        augmentations: Sequence[Augmentation],
        seed: int,
    ):
        self.split, self.channels, self.views_per_scene = split, tuple(channels), views_per_scene
        self.augmentations, self.seed = tuple(augmentations), seed

    def __getitem__(self, draw: tuple[int, int]) -> SceneViews:
        epoch, index = draw
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, epoch, index]))

        def choose(views: int) -> list[int]:
            return rng.permutation(views)[: self.views_per_scene].tolist()

        views = read_views(self.split, index, self.channels, choose)
        for augmentation in self.augmentations:
            views = augmentation(views, self.channels, rng)
        return views


class GlobalBatches(Sampler[list[tuple[int, int]]]):
    """One rank's part of each global batch, for a whole run: lists of (epoch, scene index).

    The global order runs through epoch after epoch and is the same for any number of ranks. Each global batch is
    partitioned among the ranks, and each rank's part into `accumulate` smaller batches.

    Args:
        batches: Number of global batches in the whole run.
        start: Number of global batches already trained on.
        rank, ranks: Part to return.
        accumulate: Number of batches to return the part in.
    """

    def __init__(
        self,
        order: ShuffledOrder,
        partition: Partition,
        triangles_of: Callable[[tuple[int, int]], int],
        scenes_per_batch: int,
        batches: int,
        start: int = 0,
        rank: int = 0,
        ranks: int = 1,
        accumulate: int = 1,
    ):
        if scenes_per_batch % (ranks * accumulate):
            raise ValueError(
                f"{scenes_per_batch} scenes per step do not divide among {ranks} ranks, {accumulate} batches each"
            )
        self.order, self.partition, self.triangles_of = order, partition, triangles_of
        self.scenes_per_batch = scenes_per_batch
        self.batches, self.start = batches, start
        self.rank, self.ranks, self.accumulate = rank, ranks, accumulate

    def __len__(self) -> int:
        """Return this rank's number of batches in the whole run; Lightning itself counts from `start`."""
        return self.batches * self.accumulate

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        draws = self.order.draws(self.start * self.scenes_per_batch)
        for _ in range(self.start, self.batches):
            batch = list(islice(draws, self.scenes_per_batch))
            part = self.partition(batch, self.triangles_of, self.ranks)[self.rank]
            yield from self.partition(part, self.triangles_of, self.accumulate)

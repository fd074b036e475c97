"""Training samples: augmented views of stored scenes, in the order of global batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
from torch.utils.data import Dataset, Sampler

from rfpp.batch import SceneViews
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.shards.sample import SceneSample, ViewChoice
from rfpp.shards.views import select_views
from rfpp.training.augmentation import Augmentation
from rfpp.training.batching import Partition
from rfpp.training.prefetch import FetchedAhead


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
        return self.drawn(draw, partial(self.split.read, draw[1]))

    def drawn(self, draw: tuple[int, int], read: Callable[[ViewChoice, Sequence[str]], SceneSample]) -> SceneViews:
        """Return the views of a draw; `read` decodes a choice of the scene's views and channels."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, *draw]))

        def choose(views: int) -> list[int]:
            return rng.permutation(views)[: self.views_per_scene].tolist()

        sample = read(choose, self.channels)
        views = select_views(sample, range(len(sample.fov)), self.channels)
        for augmentation in self.augmentations:
            views = augmentation(views, self.channels, rng)
        return views


@dataclass(frozen=True)
class Share:
    """A rank's share of a run's global batches.

    Attributes:
        steps: number of global batches in the whole run.
        start: number of global batches already trained on.
        rank: number of the rank, of `ranks`.
        accumulate: number of batches in which a rank reads its part of each.
    """

    steps: int
    start: int = 0
    rank: int = 0
    ranks: int = 1
    accumulate: int = 1


class GlobalBatches(Sampler[list[tuple[int, int]]]):
    """One rank's part of each global batch, for a whole run: lists of (epoch, scene index).

    The global order runs through epoch after epoch and is the same for any number of ranks. Each global batch is
    partitioned among the ranks, and each rank's part into `share.accumulate` smaller batches.
    """

    def __init__(
        self,
        order: ShuffledOrder | FetchedAhead,
        partition: Partition,
        triangles_of: Callable[[tuple[int, int]], int],
        scenes_per_step: int,
        share: Share,
    ):
        if scenes_per_step % (share.ranks * share.accumulate):
            raise ValueError(
                f"{scenes_per_step} scenes per step do not divide among {share.ranks} ranks, {share.accumulate} "
                "batches each"
            )
        self.order, self.partition, self.triangles_of = order, partition, triangles_of
        self.scenes_per_step, self.share = scenes_per_step, share

    def __len__(self) -> int:
        """Return this rank's number of batches in the whole run; Lightning itself counts from `start`."""
        return self.share.steps * self.share.accumulate

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        share = self.share
        draws = self.order.draws(share.start * self.scenes_per_step)
        for _ in range(share.start, share.steps):
            batch = list(islice(draws, self.scenes_per_step))
            part = self.partition(batch, self.triangles_of, share.ranks)[share.rank]
            yield from self.partition(part, self.triangles_of, share.accumulate)

"""What a training step sees: augmented views of stored scenes, in the order of global batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice

import numpy as np
from torch.utils.data import Dataset, Sampler

from rfpp.batch import SceneViews
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.joined import JoinedSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.shards.views import read_views
from rfpp.training.augmentation import ColourPermutation, RigidAugmentation
from rfpp.training.dealing import Dealing


class TrainingViews(Dataset):
    """Random views of a split's scenes, a pure function of (seed, epoch, scene).

    Args:
        split: stored scenes.
        channels: G-buffer channels.
        views_per_scene: views drawn without replacement from each scene's.
        rigid, colour: augmentations applied to each draw, or None.
        seed: of the draws.
    """

    def __init__(
        self,
        split: ShardSplit | JoinedSplit,
        channels: Sequence[str],
        views_per_scene: int,
        rigid: RigidAugmentation | None,
        colour: ColourPermutation | None,
        seed: int,
    ):
        self.split, self.channels = split, tuple(channels)
        self.views_per_scene, self.rigid, self.colour, self.seed = views_per_scene, rigid, colour, seed

    def __getitem__(self, draw: tuple[int, int]) -> SceneViews:
        epoch, index = draw
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, epoch, index]))
        chosen = read_views(
            self.split,
            index,
            self.channels,
            lambda views: rng.permutation(views)[: self.views_per_scene].tolist(),
        )
        if self.rigid:
            chosen = self.rigid(chosen, rng)
        if self.colour:
            chosen = self.colour(chosen, self.channels, rng)
        return chosen


class GlobalBatches(Sampler[list[tuple[int, int]]]):
    """One rank's share of each global batch, for a whole run: lists of (epoch, scene index).

    The global order runs through epoch after epoch and is the same for any number of ranks. Each global batch is dealt
    to the ranks, and what a rank has got to `accumulate` smaller batches one after the other.

    Args:
        order: of the scenes.
        dealing: who gets what.
        triangles_of: the scene of a draw has so many.
        scenes_per_batch: global, over all ranks.
        batches: global ones in the whole run.
        start: how many of them were trained on before.
        rank, ranks: which part to take.
        accumulate: in how many batches to give the part.
    """

    def __init__(
        self,
        order: ShuffledOrder,
        dealing: Dealing,
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
        self.order, self.dealing, self.triangles_of = order, dealing, triangles_of
        self.scenes_per_batch = scenes_per_batch
        self.batches, self.start = batches, start
        self.rank, self.ranks, self.accumulate = rank, ranks, accumulate

    def __len__(self) -> int:
        """Batches of this rank in the whole run; Lightning counts on from `start` itself."""
        return self.batches * self.accumulate

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        draws = self.order.draws(self.start * self.scenes_per_batch)
        for _ in range(self.start, self.batches):
            batch = list(islice(draws, self.scenes_per_batch))
            share = self.dealing(batch, self.triangles_of, self.ranks)[self.rank]
            yield from self.dealing(share, self.triangles_of, self.accumulate)

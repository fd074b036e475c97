"""Training scenes read in sequence by webdataset, shard after shard."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import count, islice
from typing import BinaryIO, NamedTuple

import numpy as np
from torch.utils.data import IterableDataset, get_worker_info
from webdataset import detshuffle
from webdataset.tariterators import group_by_keys, tar_file_expander

from rfpp.batch import SceneViews
from rfpp.errors import ShardError
from rfpp.shards.sample import decode
from rfpp.training.views import Share, TrainingViews


class _Visit(NamedTuple):
    """A shard to read in an epoch, from a scene on."""

    epoch: int
    shard: int
    start: int


class StreamedViews(IterableDataset):
    """Random views of a split's scenes without end, shuffled in a buffer of each loader process.

    Every epoch permutes the shards and divides them among the loader processes of all ranks. A process does not wait
    for the others at the end of an epoch.

    Args:
        sizes: Number of scenes to read in each shard.
        share: Batches that this rank reads; `share.start` is resumed at that scene of a process's stream, with an
            empty buffer.
        scenes_per_batch: Scenes per batch of a rank.
        buffer: Scenes, not decoded, in a process's buffer.
        skip_corrupt: Omit damaged shards with a warning, and yield None for a scene that cannot be decoded.

    Raises:
        ShardError: If a shard or a scene is damaged or missing; with `skip_corrupt`, if all shards are.
    """

    def __init__(
        self,
        views: TrainingViews,
        sizes: Sequence[int],
        share: Share,
        scenes_per_batch: int,
        buffer: int,
        skip_corrupt: bool,
    ):
        self.views, self.sizes, self.share, self.scenes_per_batch = views, list(sizes), share, scenes_per_batch
        self.buffer, self.skip_corrupt = buffer, skip_corrupt

    def __iter__(self) -> Iterator[SceneViews | None]:
        worker = get_worker_info()
        number, workers = (worker.id, worker.num_workers) if worker else (0, 1)
        # the loader takes batches from its processes in turn, and begins with the first one also when it resumes
        start = self.share.start * self.share.accumulate
        turn = (start + number) % workers
        visits = self._visits(
            part=self.share.rank * workers + turn,
            parts=self.share.ranks * workers,
            scenes_before=len(range(turn, start, workers)) * self.scenes_per_batch,
        )
        shuffle = detshuffle(self.buffer, initial=self.buffer, seed=self.views.seed)
        for draw, key, members in shuffle.run(self._stored(visits)):
            try:
                yield self.views.drawn(draw, partial(decode, key, members))
            except ShardError as error:
                if not self.skip_corrupt:
                    raise
                warnings.warn(f"skipped: {error}", stacklevel=2)
                yield None

    def _visits(self, part: int, parts: int, scenes_before: int) -> Iterator[_Visit]:
        """Yield the shards of a part of the data, beginning after `scenes_before` of its scenes."""
        for epoch in count():
            rng = np.random.default_rng(np.random.SeedSequence([self.views.seed, epoch]))
            for shard in rng.permutation(len(self.sizes))[part::parts].tolist():
                if scenes_before < self.sizes[shard]:
                    yield _Visit(epoch, shard, scenes_before)
                scenes_before = max(0, scenes_before - self.sizes[shard])

    def _stored(self, visits: Iterator[_Visit]) -> Iterator[tuple[tuple[int, int], str, dict[str, bytes]]]:
        """Yield (epoch, scene), key and members of stored scenes."""
        firsts = np.cumsum([0, *self.views.split.sizes]).tolist()
        for visit, tar_file in self._opened(visits):
            with tar_file:
                stored = group_by_keys(tar_file_expander([{"url": tar_file.name, "stream": tar_file}]))
                for position, sample in islice(enumerate(stored), visit.start, self.sizes[visit.shard]):
                    members = {name: data for name, data in sample.items() if not name.startswith("__")}
                    yield (visit.epoch, firsts[visit.shard] + position), sample["__key__"], members

    def _opened(self, visits: Iterator[_Visit]) -> Iterator[tuple[_Visit, BinaryIO]]:
        """Yield verified tars. While one is read, a thread fetches the next."""
        shards, lost = self.views.split.shards, 0
        with ThreadPoolExecutor(1) as pool:
            following = next(visits)
            fetched = pool.submit(shards[following.shard].open_verified)
            while True:
                visit, current, following = following, fetched, next(visits)
                fetched = pool.submit(shards[following.shard].open_verified)
                try:
                    tar_file, lost = current.result(), 0
                except ShardError as error:
                    lost += 1
                    if not self.skip_corrupt or lost > len(shards):
                        raise
                    warnings.warn(f"skipped: {error}", stacklevel=2)
                else:
                    yield visit, tar_file

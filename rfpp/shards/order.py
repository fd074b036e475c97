"""Training order: a lazily computed function of seed and epoch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count

import numpy as np


class ShuffledOrder:
    """Every sample once per epoch, in an order that is independent of the number of reading processes.

    Each epoch permutes the shards and shuffles the samples of `window` shards at a time, so that few files are open
    and a remote shard is fetched once per epoch. Resuming at any position costs at most one window's shuffle.

    Args:
        window: Shards shuffled together.

    Raises:
        ValueError: If there are no samples, or the window is empty.
    """

    def __init__(self, sizes: Sequence[int], seed: int, window: int) -> None:
        if sum(sizes) < 1 or window < 1:
            raise ValueError(f"{sum(sizes)} samples cannot be shuffled through windows of {window} shards")
        self._ends = np.cumsum(sizes)
        self._sizes = np.asarray(sizes)
        self._seed = seed
        self._window = window

    def __len__(self) -> int:
        """Return the number of samples in an epoch."""
        return int(self._ends[-1])

    @property
    def window_size(self) -> int:
        """Return the number of samples in the largest possible window."""
        return int(np.sort(self._sizes)[-self._window :].sum())

    def draws(self, start: int = 0) -> Iterator[tuple[int, int]]:
        """Yield (epoch, sample) without end, beginning with draw number `start`."""
        first_epoch, position = divmod(start, len(self))
        for epoch in count(first_epoch):
            for sample in self._epoch(epoch, position):
                yield epoch, sample
            position = 0

    def _epoch(self, epoch: int, position: int) -> Iterator[int]:
        shards = self._rng(epoch, 0).permutation(len(self._sizes))
        for number, first in enumerate(range(0, len(shards), self._window), start=1):
            window = shards[first : first + self._window]
            size = int(self._sizes[window].sum())
            if position < size:
                samples = np.concatenate([np.arange(self._ends[s] - self._sizes[s], self._ends[s]) for s in window])
                yield from self._rng(epoch, number).permutation(samples)[position:].tolist()
            position = max(0, position - size)

    def _rng(self, epoch: int, part: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence([self._seed, epoch], spawn_key=(part,)))


def truncated(sizes: Sequence[int], samples: int) -> list[int]:
    """Return the sizes of the shards that hold the first `samples` samples, the last shard truncated."""
    ends = np.minimum(np.cumsum([0, *sizes]), samples)
    return [size for size in np.diff(ends).tolist() if size]

"""Shards behind a URL, fetched into the cache before training reads them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread

from rfpp.errors import UserError
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder

_THREADS = 4


class FetchedAhead:
    """The draws of an order. Threads fetch the shards of the draws one window ahead.

    Without it, a window's shards are all needed within its first steps, which would wait for them. The cache must hold
    two windows. Errors are left to the reader, which meets them too.
    """

    def __init__(self, order: ShuffledOrder, split: ShardSplit):
        self.order, self.split = order, split

    def draws(self, start: int = 0) -> Iterator[tuple[int, int]]:
        """Yield (epoch, sample) without end, beginning with draw number `start`."""
        waiting: SimpleQueue[int | None] = SimpleQueue()
        for _ in range(_THREADS):  # daemons: an exit does not wait for a slow server
            Thread(target=self._fetch, args=(waiting,), daemon=True).start()
        ahead = self.order.draws(start)
        requested: set[tuple[int, int]] = set()
        try:
            for number, draw in enumerate(self.order.draws(start)):
                for epoch, sample in (next(ahead) for _ in range(1 if number else self.order.window_size)):
                    shard = self.split.shard_of(sample)
                    if (epoch, shard) not in requested:
                        requested.add((epoch, shard))
                        waiting.put(shard)
                yield draw
        finally:
            for _ in range(_THREADS):
                waiting.put(None)

    def _fetch(self, waiting: SimpleQueue[int | None]) -> None:
        while (shard := waiting.get()) is not None:
            with suppress(UserError):
                os.close(self.split.shards[shard].open())

"""Shards behind a URL are in the cache before training reads them, and the order is that of a folder."""

import time
from itertools import islice
from uuid import uuid4

import fsspec
import pytest
from small_data import make

from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.training.batching import Batching, Contiguous
from rfpp.training.prefetch import FetchedAhead
from rfpp.training.readers import IndexedReader
from rfpp.training.source import DataSource
from rfpp.training.views import Share, TrainingViews

SCENES, WINDOW = 12, 2  # in shards of one


@pytest.fixture
def remote(tmp_path):
    """A data set in memory, which threads of this process can read, and a cache."""
    root = make(tmp_path / "small", splits={"train": SCENES}, scenes_per_shard=1).root
    url = f"memory://{uuid4()}"
    files = fsspec.filesystem("memory")
    files.put(f"{root}/", url.removeprefix("memory:/"), recursive=True)
    yield url, ShardCache(tmp_path / "cache", gigabytes=1)
    files.rm(url.removeprefix("memory:/"), recursive=True)


def cached(cache: ShardCache) -> set[int]:
    """Return the numbers of the shards that are in the cache."""
    return {int(path.stem[-5:]) for path in cache.folder.glob("[!.]*.tar")}


def test_the_next_window_is_fetched_while_one_is_read(remote):
    split = ShardSplit(remote[0], "train", remote[1])
    order = ShuffledOrder(split.sizes, 3, WINDOW)
    expected = list(islice(order.draws(5), 2 * SCENES))
    ahead = FetchedAhead(order, split).draws(5)
    assert cached(remote[1]) == set()
    read = [next(ahead)]
    deadline = time.monotonic() + 20
    soon = {sample for _, sample in expected[:WINDOW]}
    while not soon <= cached(remote[1]) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert cached(remote[1]) == soon
    read += islice(ahead, 2 * SCENES - 1)
    assert read == expected
    ahead.close()


def test_missing_shards_are_left_to_the_reader(remote):
    split = ShardSplit(remote[0], "train", remote[1])
    fsspec.filesystem("memory").rm(f"{remote[0].removeprefix('memory:/')}/train-00003.tar")
    ahead = FetchedAhead(ShuffledOrder(split.sizes, 3, WINDOW), split).draws()
    assert len(list(islice(ahead, SCENES))) == SCENES
    ahead.close()


def test_the_reader_of_a_remote_set_draws_the_batches_of_its_folder(remote, tmp_path):
    def batches(root, cache):
        split = ShardSplit(root, "train", cache)
        views = TrainingViews(split, ("albedo",), 1, [], seed=5)
        source = DataSource(root, cache, None, 0, False)
        options = IndexedReader()(views, source, Batching(2, None, 1, Contiguous(), WINDOW), Share(9), 0)
        return list(islice(options["batch_sampler"], 9))

    assert batches(*remote) == batches(tmp_path / "small", None)

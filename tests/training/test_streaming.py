"""Shards streamed by webdataset: each scene once per epoch, resumed by position, damage named or skipped."""

import shutil
from itertools import chain, islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from small_data import make
from torch.utils.data import DataLoader

from rfpp.errors import ShardError, UserError
from rfpp.shards.dataset import ShardSplit
from rfpp.training.augmentation import RigidMotion
from rfpp.training.batching import Batching, Contiguous
from rfpp.training.datamodule import loader_processes
from rfpp.training.readers import WebDatasetReader
from rfpp.training.source import DataSource
from rfpp.training.views import Share, TrainingViews

SCENES, PER_STEP = 11, 2  # in shards of 2, 2, …, 1


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return make(tmp_path_factory.mktemp("stream") / "small", splits={"train": SCENES}, scenes_per_shard=2).root


def views_of(root) -> TrainingViews:
    return TrainingViews(ShardSplit(root, "train", require_all=False), ("albedo",), 1, [RigidMotion(1.0, 0.25)], seed=5)


def batches(root, count: int, buffer: int = 4, workers: int = 0, skip_corrupt: bool = False, scenes=None, **share):
    """Return the first batches of a rank: lists of views."""
    source = DataSource(root, None, scenes, 0, skip_corrupt)
    batching = Batching(PER_STEP * share.get("ranks", 1), None, 1, Contiguous(), 2)
    options = WebDatasetReader(buffer)(views_of(root), source, batching, Share(100, **share), workers)
    context = loader_processes() if workers else None
    loader = DataLoader(**options, num_workers=workers, collate_fn=list, multiprocessing_context=context)
    return list(islice(loader, count))


def keys_of(batches) -> list[str]:
    return [views.key for views in chain.from_iterable(batches)]


def test_streamed_views_are_those_of_the_indexed_reader(root):
    draws = views_of(root)
    for number, views in enumerate(chain.from_iterable(batches(root, 11, buffer=1))):
        indexed = draws[number // SCENES, int(views.key[-6:])]
        assert views.key == indexed.key
        np.testing.assert_array_equal(views.c2w, indexed.c2w)
        np.testing.assert_array_equal(views.image, indexed.image)
        np.testing.assert_array_equal(views.triangles.positions, indexed.triangles.positions)


def test_each_epoch_holds_each_scene_once_in_an_order_of_its_own(root):
    keys = keys_of(batches(root, 11, buffer=1))
    assert len(set(keys[:SCENES])) == len(set(keys[SCENES : 2 * SCENES])) == SCENES
    assert keys[:SCENES] != keys[SCENES : 2 * SCENES]
    assert keys == keys_of(batches(root, 11, buffer=1))


def test_the_buffer_mixes_shards(root):
    def pairs(keys):
        return sum(int(a[-6:]) // 2 == int(b[-6:]) // 2 for a, b in pairwise(keys))

    assert pairs(keys_of(batches(root, 50, buffer=8))) < pairs(keys_of(batches(root, 50, buffer=1))) / 2


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_divide_the_shards(root, ranks):
    parts = [set(keys_of(batches(root, SCENES // 2 // ranks, buffer=1, rank=r, ranks=ranks))) for r in range(ranks)]
    assert sum(map(len, parts)) == len(set.union(*parts))


@pytest.mark.parametrize("workers", [0, 2])
def test_resuming_continues_at_the_position(root, workers):
    whole = batches(root, 14, buffer=1, workers=workers)
    for start in (1, 6, 9):
        rest = batches(root, 14 - start, buffer=1, workers=workers, start=start)
        assert keys_of(rest) == keys_of(whole[start:])
        assert np.array_equal(rest[0][0].image, whole[start][0].image)


def test_only_the_first_scenes_are_read(root):
    assert set(keys_of(batches(root, 6, buffer=1, scenes=3))) == {f"train-00000{i}" for i in range(3)}


def test_damaged_and_missing_shards_are_named_or_skipped(root, tmp_path):
    bad = Path(shutil.copytree(root, tmp_path / "bad"))
    content = bytearray((bad / "train-00001.tar").read_bytes())
    content[len(content) // 2] ^= 1
    (bad / "train-00001.tar").write_bytes(content)
    with pytest.raises(ShardError, match=r"train-00001\.tar: does not have the sha256 in the manifest: delete"):
        batches(bad, 6)
    (bad / "train-00002.tar").unlink()
    with pytest.warns(UserWarning, match="skipped: .*train-0000"):
        keys = keys_of(batches(bad, 11, skip_corrupt=True))
    assert set(keys) == {f"train-{i:06d}" for i in range(SCENES) if i // 2 not in (1, 2)}
    for tar in bad.glob("*.tar"):
        tar.unlink()
    with pytest.raises(ShardError, match="the shard is missing"), pytest.warns(UserWarning, match="skipped"):
        batches(bad, 1, skip_corrupt=True)


def test_more_loader_processes_than_shards_are_refused(root):
    with pytest.raises(UserError, match=r"6 shards do not divide among 8 loader processes: lower datamodule\.workers"):
        batches(root, 1, workers=4, ranks=2)

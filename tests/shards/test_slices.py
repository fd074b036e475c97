"""Slices of a data set, and its status."""

import shutil
from pathlib import Path

import pytest
from filelock import FileLock
from small_data import InProcess, InterruptAfter, hashes, make, recipe

from rfpp.errors import ShardError, UserError
from rfpp.shards import generation
from rfpp.shards.recipe import Slice
from rfpp.shards.status import status


def make_slice(root: Path, index: int, count: int) -> None:
    generation.make(recipe(root), InProcess(), lambda done, total: None, Slice(index, count))


def test_merged_slices_equal_one_run(tmp_path, finished):
    for index in (2, 0, 1):
        make_slice(tmp_path / f"machine{index}", index, 3)
    here = tmp_path / "machine0"
    with pytest.raises(ShardError, match=r"4 of 6 shards are not finished, first train-00001\.tar.*copy them here"):
        generation.merge(recipe(here))
    assert status(recipe(here)).slices(3) == (1, 2)
    for index in (1, 2):
        for path in (tmp_path / f"machine{index}").glob("*-*.*"):
            shutil.copy(path, here)
    assert status(recipe(here)).is_complete
    assert generation.merge(recipe(here)).hash == finished.hash
    assert hashes(here) == hashes(finished.root)


def test_a_slice_is_locked(tmp_path):
    with FileLock(tmp_path / ".slice-1-of-3.lock"):
        with pytest.raises(UserError, match="another process is generating slice 1 of 3"):
            make_slice(tmp_path, 1, 3)
        make_slice(tmp_path, 2, 3)
    make_slice(tmp_path, 1, 3)
    assert not list(tmp_path.glob("*.lock"))


@pytest.mark.parametrize(("index", "count"), [(3, 3), (-1, 2), (0, 0)])
def test_a_slice_that_does_not_exist_is_refused(index, count):
    with pytest.raises(UserError, match=rf"slice\.index={index} of slice\.count={count}"):
        Slice(index, count)


def test_status_counts_waiting_and_missing_samples(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path, progress=InterruptAfter(3))
    found = status(recipe(tmp_path))
    train = found.splits["train"]
    assert (train.finished_shards, train.shards, train.finished_scenes, train.scenes) == (1, 3, 2, 5)
    assert train.waiting_scenes >= 1
    assert found.splits["test"].missing == (5,)
    assert not found.is_complete and not found.is_merged

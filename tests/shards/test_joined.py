"""Data sets that are trained on together."""

import numpy as np
import pytest
from small_data import make

from rfpp.errors import ShardError
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.joined import JoinedSplit, open_manifest, open_split


@pytest.fixture(scope="module")
def roots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joined")
    few, many = ({"train": count, "validation": 1} for count in (2, 3))
    return [make(folder / "few", splits=few).root, make(folder / "many", splits=many).root]


def test_scenes_of_all_come_one_after_the_other(roots):
    joined, parts = open_split(roots, "train"), [ShardSplit(root, "train") for root in roots]
    apart = [(part, index) for part in parts for index in range(len(part))]
    assert isinstance(joined, JoinedSplit) and len(joined) == sum(joined.sizes) == 5
    for number, (part, index) in enumerate(apart):
        assert joined.key(number) == part.key(index)
        assert joined.triangles(number) == part.triangles(index)
        np.testing.assert_array_equal(joined[number].images, part[index].images)
    with pytest.raises(IndexError):
        joined.read(5)


def test_one_that_is_named_twice_counts_twice(roots):
    assert len(open_split([roots[0], roots[0], roots[1]], "train")) == 7


def test_together_they_have_a_name_and_a_hash_of_their_own(roots):
    one, both, turned = open_manifest(roots[0]), open_manifest(roots), open_manifest(roots[::-1])
    assert both.counts["scenes"] == 7 and both.name == f"{one.name}+{open_manifest(roots[1]).name}"
    assert len({one.hash, both.hash, turned.hash}) == 3


def test_images_of_different_sizes_are_refused(roots, tmp_path):
    large = make(tmp_path / "large", splits={"train": 1, "validation": 1}, resolution=32).root
    with pytest.raises(ShardError, match=r"images differ in size \(.*: 32²\)"):
        open_manifest([roots[0], large])
    with pytest.raises(ShardError, match=r"datamodule\.root names no data set"):
        open_manifest([])

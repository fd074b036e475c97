"""Scenes are dealt to devices: each once, equally many to each, and evenly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rfpp.training.dealing import BySize, InOrder


def loads(parts: list[list[int]], sizes: list[int]) -> list[int]:
    return [sum(sizes[i] for i in part) for part in parts]


@pytest.fixture
def sizes() -> list[int]:
    """Of scenes as in training at scale, and a few that stand out."""
    rng = np.random.default_rng(0)
    return [int(n) for n in (*rng.uniform(10_000, 80_000, 28), 200_000, 190_000, 180_000, 1)]


@pytest.mark.parametrize("parts", [2, 4, 8, 16])
def test_sizes_are_evened_out(sizes, parts):
    in_order, by_size = (
        loads(dealing(range(32), sizes.__getitem__, parts), sizes) for dealing in (InOrder(), BySize())
    )
    best = max(sum(by_size) / parts, max(sizes))  # nothing can be below either
    assert max(by_size) < min(1.15 * best, max(in_order))


@given(st.lists(st.integers(0, 10**6), min_size=24, max_size=24), st.sampled_from([1, 2, 3, 4, 6, 8, 12, 24]))
def test_each_is_dealt_once_and_parts_are_equal_in_number(sizes, parts):
    for dealing in (InOrder(), BySize()):
        dealt = dealing(range(24), sizes.__getitem__, parts)
        assert sorted(draw for part in dealt for draw in part) == list(range(24))
        assert {len(part) for part in dealt} == {24 // parts}
        for part in dealt:  # in the order of the batch
            assert part == sorted(part)


def test_no_part_gets_the_largest_scene_more_often_than_others():
    rng = np.random.default_rng(0)
    owners = []
    for _ in range(200):
        scenes = rng.integers(1, 1000, 8).tolist()
        dealt = BySize()(range(8), scenes.__getitem__, 4)
        largest = int(np.argmax(scenes))
        owners.append(next(number for number, part in enumerate(dealt) if largest in part))
    assert np.bincount(owners, minlength=4).min() > 30  # of 50


def test_in_order_asks_for_no_sizes():
    def triangles_of(draw: str) -> int:
        raise AssertionError("nobody needs it")

    assert InOrder()("abcdef", triangles_of, 3) == [["a", "b"], ["c", "d"], ["e", "f"]]

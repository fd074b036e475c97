"""Partitions of a batch: every scene once, parts of equal length and similar load."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rfpp.training.batching import BalancedBySize, Contiguous


def loads(parts: list[list[int]], sizes: list[int]) -> list[int]:
    return [sum(sizes[i] for i in part) for part in parts]


@pytest.fixture
def sizes() -> list[int]:
    """Sizes of the large-scale scenes, and a few outliers."""
    rng = np.random.default_rng(0)
    return [int(n) for n in (*rng.uniform(10_000, 80_000, 28), 200_000, 190_000, 180_000, 1)]


@pytest.mark.parametrize("parts", [2, 4, 8, 16])
def test_loads_are_balanced(sizes, parts):
    contiguous, balanced = (
        loads(partition(range(32), sizes.__getitem__, parts), sizes) for partition in (Contiguous(), BalancedBySize())
    )
    best = max(sum(balanced) / parts, max(sizes))  # lower bound
    assert max(balanced) < min(1.15 * best, max(contiguous))


@given(st.lists(st.integers(0, 10**6), min_size=24, max_size=24), st.sampled_from([1, 2, 3, 4, 6, 8, 12, 24]))
def test_every_scene_is_in_one_part_and_parts_have_equal_length(sizes, parts):
    for partition in (Contiguous(), BalancedBySize()):
        found = partition(range(24), sizes.__getitem__, parts)
        assert sorted(draw for part in found for draw in part) == list(range(24))
        assert {len(part) for part in found} == {24 // parts}
        for part in found:
            assert part == sorted(part)


def test_no_part_gets_the_largest_scene_more_often_than_others():
    rng = np.random.default_rng(0)
    owners = []
    for _ in range(200):
        scenes = rng.integers(1, 1000, 8).tolist()
        found = BalancedBySize()(range(8), scenes.__getitem__, 4)
        largest = int(np.argmax(scenes))
        owners.append(next(number for number, part in enumerate(found) if largest in part))
    assert np.bincount(owners, minlength=4).min() > 30  # of 50

"""Training order: every sample once per epoch, shuffled across shards, resumable at any position."""

from itertools import islice

import numpy as np
import pytest

from rfpp.shards.order import ShuffledOrder, truncated

SIZES = [4, 7, 1, 5, 6, 3]
TOTAL = sum(SIZES)


def epochs(order: ShuffledOrder, count: int) -> list[list[int]]:
    draws = list(islice(order.draws(), count * len(order)))
    return [[sample for epoch, sample in draws if epoch == e] for e in range(count)]


def shards_of(samples: list[int]) -> list[int]:
    return np.searchsorted(np.cumsum(SIZES), samples, side="right").tolist()


@pytest.mark.parametrize("window", [1, 2, 4, 100])
def test_every_epoch_is_another_permutation(window):
    first, second, third = epochs(ShuffledOrder(SIZES, 0, window), 3)
    assert sorted(first) == sorted(second) == sorted(third) == list(range(TOTAL))
    assert first != second != third != first


def test_order_is_a_function_of_seed():
    assert epochs(ShuffledOrder(SIZES, 3, 2), 2) == epochs(ShuffledOrder(SIZES, 3, 2), 2)
    assert epochs(ShuffledOrder(SIZES, 3, 2), 2) != epochs(ShuffledOrder(SIZES, 4, 2), 2)


@pytest.mark.parametrize("window", [1, 2, 3])
def test_shards_are_mixed_within_a_window_only(window):
    for epoch in epochs(ShuffledOrder(SIZES, 1, window), 8):
        shards = shards_of(epoch)
        visits = {shard: (shards.index(shard), TOTAL - 1 - shards[::-1].index(shard)) for shard in range(len(SIZES))}
        open_at = [sum(first <= i <= last for first, last in visits.values()) for i in range(TOTAL)]
        assert max(open_at) <= window
    if window > 1:
        assert max(open_at) == window


@pytest.mark.parametrize("start", range(2 * TOTAL + 2))
def test_any_position_continues_the_uninterrupted_order(start):
    order = ShuffledOrder(SIZES, 5, 2)
    whole = list(islice(order.draws(), 3 * TOTAL))
    assert list(islice(ShuffledOrder(SIZES, 5, 2).draws(start), 20)) == whole[start : start + 20]


def test_resuming_late_shuffles_only_one_window(monkeypatch):
    order = ShuffledOrder([100] * 5000, seed=0, window=16)
    shuffled = []
    rng = ShuffledOrder._rng
    monkeypatch.setattr(ShuffledOrder, "_rng", lambda self, *which: shuffled.append(which) or rng(self, *which))
    epoch, _ = next(order.draws(7 * len(order) + 123_456))
    assert epoch == 7
    assert shuffled == [(7, 0), (7, 123_456 // 1600 + 1)]


@pytest.mark.parametrize(("sizes", "window"), [([], 1), ([0, 0], 1), ([3], 0)])
def test_nothing_to_shuffle_is_refused(sizes, window):
    with pytest.raises(ValueError, match="cannot be shuffled"):
        ShuffledOrder(sizes, 0, window)


@pytest.mark.parametrize(("samples", "sizes"), [(0, []), (3, [3]), (4, [4]), (12, [4, 7, 1]), (13, [4, 7, 1, 1])])
def test_the_first_samples_lie_in_truncated_shards(samples, sizes):
    assert truncated(SIZES, samples) == sizes

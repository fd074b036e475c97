from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform_integer


@dataclass(frozen=True)
class Sampler(HasIntervals):
    size: Interval
    other: object = None


def test_any_sequence_becomes_a_tuple_and_other_fields_stay():
    other = [3, 1]
    sampler = Sampler([1, 2.5], other)
    assert sampler.size == (1, 2.5)
    assert sampler.other is other


@pytest.mark.parametrize("bad", [[2, 1], [1], [1, 2, 3], [float("nan"), 1]])
def test_a_wrong_interval_is_named(bad):
    with pytest.raises(SceneError, match=r"Sampler\.size: .* is not an interval"):
        Sampler(bad)


def test_integers_include_both_ends():
    rng = np.random.default_rng(0)
    assert {uniform_integer(rng, (3, 5)) for _ in range(100)} == {3, 4, 5}

import math

import numpy as np
import pytest

from rfpp.metrics.flicker import flicker


@pytest.fixture
def moving():
    """A bright square that goes right, in six frames."""
    frames = np.full((6, 12, 16, 3), 0.1, np.float32)
    for number, frame in enumerate(frames):
        frame[4:8, number : number + 4] = 0.8
    return frames


def test_a_perfect_prediction_has_none_and_a_still_one_as_much_as_the_reference_changes(moving):
    assert flicker(moving, moving) == 0
    assert flicker([moving[2]] * 6, moving) == pytest.approx(1)


def test_errors_that_stay_are_no_flicker_and_errors_that_come_and_go_are(moving):
    stain = np.zeros_like(moving)
    stain[:, 9:] = 0.3  # where nothing moves
    assert flicker(moving + stain, moving) == pytest.approx(0, abs=1e-6)
    stain[::2] = 0
    assert flicker(moving + stain, moving) > 1


def test_where_the_reference_rests_there_is_no_measure(moving):
    still = [moving[0]] * 6
    assert flicker(moving, still) == math.inf
    assert math.isnan(flicker(still, still))
    assert math.isnan(flicker(moving[:1], moving[:1]))

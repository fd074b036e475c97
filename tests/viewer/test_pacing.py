"""Resolutions while something moves."""

import pytest

from rfpp.viewer.pacing import Pacing


@pytest.mark.parametrize(
    ("aspect", "size"), [(1.0, (256, 256)), (2.0, (128, 256)), (0.5, (256, 128)), (1.6, (160, 256))]
)
def test_at_rest_the_longer_side_is_as_asked_for(aspect, size):
    assert Pacing(patch=4, seconds=0.1).size(256, aspect) == size


def test_an_image_in_motion_takes_the_time_it_may():
    pacing = Pacing(patch=4, seconds=0.1)
    assert pacing.moving_size(512, 1.0) == (64, 64)  # nothing is known
    for _ in range(20):
        size = pacing.moving_size(512, 1.0)
        pacing.took(size, 2e-6 * size[0] * size[1])
    assert 0.09 < 2e-6 * size[0] * size[1] < 0.105  # sides are multiples of the patch


def test_it_is_never_larger_than_at_rest_nor_smaller_than_can_be_seen():
    fast, slow = Pacing(patch=4, seconds=0.1), Pacing(patch=4, seconds=0.1)
    fast.took((64, 64), 1e-4)
    slow.took((64, 64), 10.0)
    assert fast.moving_size(128, 1.0) == (128, 128)
    assert slow.moving_size(512, 1.0) == (64, 64)
    assert slow.moving_size(32, 1.0) == (32, 32)

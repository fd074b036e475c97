"""Resolutions of views at rest and in motion."""

import pytest

from rfpp.viewer.pacing import Pacing


@pytest.mark.parametrize(
    ("aspect", "size"), [(1.0, (256, 256)), (2.0, (128, 256)), (0.5, (256, 128)), (1.6, (160, 256))]
)
def test_the_longer_side_at_rest(aspect, size):
    assert Pacing(patch=4, seconds=0.1).size(256, aspect) == size


def test_images_in_motion_meet_the_target_time():
    pacing = Pacing(patch=4, seconds=0.1)
    assert pacing.moving_size(512, 1.0) == (64, 64)  # no time is known
    for _ in range(20):
        size = pacing.moving_size(512, 1.0)
        pacing.record(size, 2e-6 * size[0] * size[1])
    assert 0.09 < 2e-6 * size[0] * size[1] < 0.105  # sides are multiples of the patch

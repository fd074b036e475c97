import pytest
import torch

from rfpp.radiosity.sample_means import means, repeated


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_pixel_is_the_mean_of_its_points(number):
    points = torch.rand(2, 5, 4 * number, 6 * number)
    torch.testing.assert_close(means(points, number), torch.nn.functional.avg_pool2d(points, number))


def test_points_repeat_their_pixel():
    pixels = torch.rand(1, 2, 3, 4)
    torch.testing.assert_close(means(repeated(pixels, 2), 2), pixels)
    assert torch.equal(repeated(pixels, 2)[..., 1::2, ::2], pixels)

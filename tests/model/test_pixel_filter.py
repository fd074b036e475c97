"""Pixels from what their centres see."""

import torch

from rfpp.model.pixel_filter import CentreSample, PixelFilter


def test_a_centre_sample_is_the_pixel():
    radiance = torch.rand(2, 3, 5, 6)
    assert torch.equal(CentreSample()(radiance), radiance)


def test_the_filter_spreads_light_without_making_any():
    point = torch.zeros(1, 3, 7, 7)
    point[0, 1, 3, 3] = 100.0
    image = PixelFilter(0.125)(point)
    torch.testing.assert_close(image.sum(), point.sum())
    torch.testing.assert_close(image[0, 1, 3], torch.tensor([0, 0, 0.125 * 75, 0.75 * 75, 0.125 * 75, 0, 0]))
    assert not image[0, ::2].any()


def test_pixels_of_several_points_take_less_of_their_neighbours():
    image = torch.rand(1, 3, 6, 6)
    torch.testing.assert_close(PixelFilter(0.125)(image, points=2), PixelFilter(0.0625)(image))


def test_an_even_image_stays_as_it_is_up_to_its_borders():
    torch.testing.assert_close(PixelFilter(0.2)(torch.full((1, 3, 4, 4), 3.0)), torch.full((1, 3, 4, 4), 3.0))

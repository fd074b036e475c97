"""More points of the G-buffer than pixels: shaded one by one, averaged to pixels."""

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_decode
from rfpp.model.pixel_filter import CentreSample

ALBEDO, SPECULAR, LIGHT = slice(0, 3), slice(7, 10), slice(10, 19)


@pytest.fixture(scope="module")
def known_light():
    net = network("experiment=quickstart", "model=known_light")
    net.decoder.film = CentreSample()
    return net


@pytest.fixture
def views():
    made = random_views(np.random.default_rng(0), channels=25)
    made.gbuffer[:, 24] *= -1  # positions in front of the camera
    return made


def radiance(net, views, gbuffer: np.ndarray, supersampling: int) -> torch.Tensor:
    """[views, 3, 16, 16] of the scene with this G-buffer."""
    batch = RaggedBatch.pack([views])
    with torch.no_grad():
        seen = torch.from_numpy(gbuffer)[None]
        return log_decode(net.view(net.encode(batch), batch.c2w, batch.fov, seen, supersampling))[0]


def repeated(gbuffer: np.ndarray, number: int) -> np.ndarray:
    return gbuffer.repeat(number, axis=2).repeat(number, axis=3)


@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize(
    ("overrides", "channels"),
    [((), 7), (("experiment=quickstart", "model=known_light"), 25), (("model=renderformer",), 0)],
    ids=["normals and depth", "known light", "none"],
)
def test_points_that_are_alike_change_nothing(views, overrides, channels, number):
    net = network(*overrides)
    net.decoder.film = CentreSample()  # how much of its neighbours a pixel takes follows from its points
    gbuffer = views.gbuffer[:, :channels]
    together = radiance(net, views, repeated(gbuffer, number), number)
    torch.testing.assert_close(together, radiance(net, views, gbuffer, 1), rtol=1e-4, atol=1e-5)


def halved(gbuffer: np.ndarray, *channels: slice) -> np.ndarray:
    """Of each pixel's points the left ones are black and the right ones twice as bright: its mean stays."""
    points = repeated(gbuffer, 2)
    for chosen in channels:
        points[:, chosen, :, ::2] = 0
        points[:, chosen, :, 1::2] *= 2
    return points


def test_a_pixel_with_an_outline_is_the_mean_of_both_surfaces(known_light, views):
    expected = radiance(known_light, views, views.gbuffer, 1)
    both = radiance(known_light, views, halved(views.gbuffer, ALBEDO, SPECULAR), 2)
    torch.testing.assert_close(both, expected, rtol=1e-4, atol=1e-5)


def test_light_and_reflectance_meet_at_the_point(known_light, views):
    """Where all known light falls on the surface that reflects, twice of it returns; what the network adds stays."""
    reflectance = radiance(known_light, views, halved(views.gbuffer, ALBEDO, SPECULAR), 2)
    together = radiance(known_light, views, halved(views.gbuffer, ALBEDO, SPECULAR, LIGHT), 2)
    assert (together > reflectance).all()
    assert (together < 2 * reflectance + 0.02).all()  # further light may be a little below zero


def test_tokens_read_the_means_of_pixels(known_light, views):
    noise = np.random.default_rng(1).uniform(-0.1, 0.1, (*views.gbuffer.shape[:2], 16, 2, 16, 2)).astype(np.float32)
    noise -= noise.mean((3, 5), keepdims=True)
    gbuffer = repeated(views.gbuffer, 2)
    gbuffer[:, 3:7] += noise.reshape(gbuffer.shape)[:, 3:7]  # normal and roughness, which only tokens read
    expected = radiance(known_light, views, views.gbuffer, 1)
    torch.testing.assert_close(radiance(known_light, views, gbuffer, 2), expected, rtol=1e-3, atol=1e-4)
    assert not torch.allclose(radiance(known_light, views, gbuffer[:, :, ::2, ::2], 1), expected, rtol=1e-2)

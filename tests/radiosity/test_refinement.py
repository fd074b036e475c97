"""The refinement of finished images: what it may change, and what it reads."""

import math

import pytest
import torch

from rfpp.radiosity.refinement import Refinement

FOV = torch.tensor([40.0, 60.0])


def refinement(out: float = 0.0) -> Refinement:
    """Small; weights of its last layer are about `out`, 0 as before training."""
    torch.manual_seed(0)
    net = Refinement([8, 12, 16], bound=1.0)
    torch.nn.init.normal_(net.out.weight, std=out)
    return net.eval().requires_grad_(False)


def views(height: int = 20, width: int = 24) -> tuple[torch.Tensor, torch.Tensor]:
    """Images and surfaces of random numbers, normals of unit length."""
    generator = torch.Generator().manual_seed(1)
    radiance, surfaces = (torch.rand(2, channels, height, width, generator=generator) for channels in (3, 13))
    surfaces[:, 7:10] = torch.nn.functional.normalize(surfaces[:, 7:10] - 0.5, dim=1)
    return radiance, surfaces


def test_before_training_an_image_of_one_color_stays_as_it_is():
    _, surfaces = views()
    gray = torch.full((2, 3, 20, 24), 0.7)
    torch.testing.assert_close(refinement()(gray, surfaces, FOV), gray)


def test_before_training_a_pixel_keeps_seven_eighths_of_itself():
    _, surfaces = views()
    dot = torch.full((2, 3, 20, 24), 0.25)
    dot[..., 10, 10] = 1.25
    refined = refinement()(dot, surfaces, FOV)
    assert refined[..., 10, 10].mean() == pytest.approx(0.25 + 7 / 8, abs=0.01)
    torch.testing.assert_close(refined.sum((-2, -1)), dot.sum((-2, -1)), rtol=2e-3, atol=0.0)


def test_a_bright_edge_does_not_spill():
    _, surfaces = views()
    bright = torch.full((2, 3, 20, 24), 0.01)
    bright[..., 10, 10] = 100.0
    refined = refinement()(bright, surfaces, FOV)
    assert (refined[..., 10, 11] < 0.03).all()  # a neighbor has a share of 1/60: 1.7 of 100


def test_twice_the_light_is_twice_the_image_and_none_is_none():
    net, (radiance, surfaces) = refinement(out=1.0), views()
    torch.testing.assert_close(net(2 * radiance, surfaces, FOV), 2 * net(radiance, surfaces, FOV))
    assert not net(torch.zeros_like(radiance), surfaces, FOV).any()


def test_no_light_spills_into_a_black_background():
    net, (radiance, surfaces) = refinement(out=1.0), views()
    black = torch.zeros(2, 1, 20, 24, dtype=bool)
    black[..., 8:10, 5:] = True
    image, without = radiance.masked_fill(black, 0), surfaces.clone()
    without[:, 7:10] = without[:, 7:10].masked_fill(black, 0)
    refined = net(image, without, FOV)
    assert not refined.masked_select(black).any() and refined.masked_select(~black).all()
    assert net(image, surfaces, FOV).all(), "a surface that no sample lit takes light from its neighbors"
    assert net(radiance, without, FOV).all(), "nor is what an outline's points lit beside it black"


def test_pixels_stay_within_the_bound_of_their_neighbors():
    radiance, surfaces = views()
    refined = refinement(out=100.0)(radiance, surfaces, FOV)
    padded = torch.nn.functional.pad(radiance, [1] * 4, mode="replicate")
    darkest = -torch.nn.functional.max_pool2d(-padded, 3, stride=1)
    brightest = torch.nn.functional.max_pool2d(padded, 3, stride=1)
    # up to one factor, which keeps the energy of the image
    lowest, highest = (refined / darkest).amin((1, 2, 3)), (refined / brightest).amax((1, 2, 3))
    assert (math.exp(-1) * highest <= math.e * lowest * (1 + 1e-5)).all()
    assert (lowest >= math.exp(-2)).all() and (highest <= math.exp(2)).all()
    assert (refined > 1.5 * brightest).any(), "corrections that large were to be tried"


def test_an_image_keeps_its_energy():
    net, (radiance, surfaces) = refinement(out=0.3), views()
    refined = net(radiance, surfaces, FOV)
    assert (refined - radiance).abs().mean() > 0.02
    torch.testing.assert_close(refined.mean((1, 2, 3)), radiance.mean((1, 2, 3)))
    net.out.bias[:3] -= 1  # darker
    torch.testing.assert_close(net(radiance, surfaces, FOV).mean((1, 2, 3)), radiance.mean((1, 2, 3)))


@pytest.mark.parametrize("size", [(16, 16), (30, 34), (5, 7)])
def test_any_size(size):
    assert refinement(out=1.0)(*views(*size), FOV).shape == (2, 3, *size)


@pytest.mark.parametrize("channel", range(13))
def test_every_surface_channel_is_read(channel):
    net, (radiance, surfaces) = refinement(out=1.0), views()
    changed = surfaces.clone()
    changed[:, channel] += 0.5
    assert not torch.allclose(net(radiance, changed, FOV), net(radiance, surfaces, FOV))


def test_what_counts_of_places_is_how_large_a_pixel_is_there():
    net, (radiance, surfaces) = refinement(out=1.0), views()
    turned, farther = surfaces.clone(), surfaces.clone()
    turned[:, 10:] = surfaces[:, [11, 12, 10]]
    farther[:, 10:] *= 2
    narrower = torch.rad2deg(2 * torch.atan(torch.tan(torch.deg2rad(FOV) / 2) / 2))
    torch.testing.assert_close(net(radiance, turned, FOV), net(radiance, surfaces, FOV))
    assert not torch.allclose(net(radiance, farther, FOV), net(radiance, surfaces, FOV))
    torch.testing.assert_close(net(radiance, farther, narrower), net(radiance, surfaces, FOV), rtol=1e-4, atol=1e-5)

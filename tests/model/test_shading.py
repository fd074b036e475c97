"""From the head's maps to radiance."""

import numpy as np
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.model.pixel_filter import CentreSample
from rfpp.model.shading import LightBeyondDirect, LightBeyondReflection, LogRadiance, ReflectedLight


def test_log_radiance_is_decoded():
    maps = torch.rand(2, 3, 4, 4)
    torch.testing.assert_close(LogRadiance()(maps, torch.empty(2, 0, 4, 4)), 10**maps - 1)


def test_reflected_light_is_diffuse_plus_glossy():
    maps, gbuffer = torch.rand(2, 6, 4, 4), torch.rand(2, 6, 4, 4)
    expected = gbuffer[:, :3] * (10 ** maps[:, :3] - 1) + gbuffer[:, 3:] * (10 ** maps[:, 3:] - 1)
    torch.testing.assert_close(ReflectedLight()(maps, gbuffer), expected)


def test_nothing_beyond_direct_is_the_direct_light_alone():
    albedo, specular, diffuse, glossy = lit = torch.rand(4, 2, 3, 4, 4) * torch.tensor([1, 1, 9, 9]).view(4, 1, 1, 1, 1)
    gbuffer = torch.cat([albedo, specular, log_encode(diffuse), log_encode(glossy)], dim=1)
    nothing = torch.zeros(2, 12, 4, 4, requires_grad=True)
    image = LightBeyondDirect()(nothing, gbuffer)
    torch.testing.assert_close(image, albedo * diffuse + specular * glossy)
    assert (LightBeyondDirect()(nothing + 0.1, gbuffer) > image).all()
    assert lit.min() > 0
    image.sum().backward()
    assert (nothing.grad > 0).all()


def test_known_light_is_corrected_and_further_light_is_added():
    albedo, specular, diffuse, glossy = torch.rand(4, 2, 3, 4, 4)
    gbuffer = torch.cat([albedo, specular, log_encode(diffuse), log_encode(glossy)], dim=1)
    known, further = albedo * diffuse + specular * glossy, torch.rand(2, 6, 4, 4)
    for correction, factor in ((-50.0, 0), (0.0, 1), (50.0, 2)):
        maps = torch.cat([torch.full((2, 6, 4, 4), correction), further], dim=1)
        expected = factor * known + ReflectedLight()(further, gbuffer[:, :6])
        torch.testing.assert_close(LightBeyondDirect()(maps, gbuffer), expected)


def test_a_reflection_joins_the_glossy_light():
    albedo, specular, diffuse, glossy, reflected = torch.rand(5, 2, 3, 4, 4)
    lit = [albedo, specular, log_encode(diffuse), log_encode(glossy), log_encode(reflected)]
    maps, gbuffer = torch.rand(2, 12, 4, 4), torch.cat(lit, dim=1)
    image = LightBeyondReflection()(torch.zeros_like(maps), gbuffer)
    torch.testing.assert_close(image, albedo * diffuse + specular * (glossy + reflected))
    lit[3], lit[4] = log_encode(glossy + reflected), torch.zeros_like(reflected)
    torch.testing.assert_close(LightBeyondReflection()(maps, gbuffer), LightBeyondDirect()(maps, torch.cat(lit[:4], 1)))


def test_a_pixel_below_zero_is_nearly_black_and_can_come_back():
    maps = torch.full((1, 3, 2, 2), -3.0, requires_grad=True)
    image = LogRadiance()(maps, torch.empty(1, 0, 2, 2))
    assert (image.abs() < 3e-3).all()
    (-image.sum()).backward()  # a loss that asks for more light
    assert (maps.grad < -1).all()


def test_a_surface_that_reflects_nothing_is_black_and_colours_come_from_their_own_reflectance():
    net = network("experiment=quickstart", "model=known_light")
    net.decoder.film = CentreSample()
    views = random_views(np.random.default_rng(0), channels=25)
    names = net.gbuffer_channels
    light = ("direct_diffuse", "direct_glossy", "reflected_light", "reflected_albedo")
    assert names == ("albedo", "normal", "roughness", "specular", *light, "position")
    views.gbuffer[:, :3] = 0  # albedo
    views.gbuffer[:, 7:10] = 0  # specular
    views.gbuffer[:, 1, :, :8] = 0.5  # a left half with green albedo
    with torch.no_grad():
        image = net(RaggedBatch.pack([views])).log_radiance
    assert torch.equal(image[..., 8:], torch.zeros_like(image[..., 8:]))
    assert (image[:, :, 1, :, :8].abs() > 0).all()
    assert torch.equal(image[:, :, ::2, :, :8], torch.zeros_like(image[:, :, ::2, :, :8]))

"""Maps of coarse pixels on fine ones: smooth along a surface, sharp at its outline."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_decode
from rfpp.model.guided_upsampling import GuidedUpsampling
from rfpp.model.pixel_filter import CentreSample


def plane(height: int, width: int) -> torch.Tensor:
    """[1, 6, H, W] normals and positions of a floor of side 1 seen from above."""
    y, x = torch.meshgrid((torch.arange(height) + 0.5) / height, (torch.arange(width) + 0.5) / width, indexing="ij")
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, height, width)
    return torch.cat([up, torch.stack([x, y, torch.full_like(x, -1.0)])])[None]


@pytest.mark.parametrize("stride", [1, 2, 3, 4])
def test_on_one_surface_it_is_bilinear(stride):
    maps = torch.randn(1, 5, 6, 4)
    fine = GuidedUpsampling()(maps, plane(6, 4), plane(6 * stride, 4 * stride))
    expected = F.interpolate(maps, scale_factor=stride, mode="bilinear", align_corners=False)
    torch.testing.assert_close(fine, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("edge", ["turned", "behind"])
def test_it_does_not_cross_an_outline(edge):
    """The right half is another surface: what is said of one does not show on the other."""

    def half(size: int) -> torch.Tensor:
        guides = plane(size, size)
        if edge == "turned":
            guides[:, :3, :, size // 2 :] = torch.tensor([1.0, 0.0, 0.0])[:, None, None]
        guides[:, 5, :, size // 2 :] -= 0.5
        return guides

    maps = torch.zeros(1, 1, 8, 8)
    maps[..., 4:] = 1.0
    fine = GuidedUpsampling()(maps, half(8), half(32))
    assert fine[..., :16].max() < 0.01
    assert fine[..., 16:].min() > 0.99


def test_what_lies_on_no_known_surface_takes_the_nearest():
    fine = GuidedUpsampling()(torch.ones(1, 2, 4, 4), plane(4, 4), torch.zeros(1, 6, 16, 16))
    torch.testing.assert_close(fine, torch.ones(1, 2, 16, 16))


@pytest.fixture(scope="module")
def known_light():
    net = network("experiment=quickstart", "model=known_light")
    net.decoder.film = CentreSample()
    return net


def test_tokens_see_coarse_pixels_and_light_is_shaded_at_fine_ones(known_light):
    """Known light and reflectances stay as sharp as they are; the four pixels of a coarse one are told alike."""
    views = random_views(np.random.default_rng(0), channels=25)
    views.gbuffer[:, 24] *= -1  # positions in front of the camera
    batch = RaggedBatch.pack([views])

    def radiance(net, stride: int) -> torch.Tensor:
        with torch.no_grad():
            return log_decode(net.view(net.encode(batch), batch.c2w, batch.fov, batch.gbuffer, 1, stride))[0]

    assert not torch.allclose(radiance(known_light, 1), radiance(known_light, 2), rtol=1e-3)
    silent = copy.deepcopy(known_light)
    for parameter in silent.decoder.head.out[-1].parameters():
        torch.nn.init.zeros_(parameter)
    torch.testing.assert_close(radiance(silent, 1), radiance(silent, 2), rtol=1e-5, atol=1e-6)
    batch.gbuffer[:, :, [0, 1, 2, 7, 8, 9], :, ::2] = 0  # both albedos of every second column
    assert radiance(known_light, 2)[..., ::2].abs().max() < 1e-6

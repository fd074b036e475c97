"""Factors of light at pixels: what they multiply, and how far they go."""

import math
from dataclasses import replace

import pytest
import torch
from networks import network
from stored_sample import stored_sample

from rfpp.batch import RaggedBatch
from rfpp.gbuffer.first_hit import BOUNCED_LIGHT, CELL_CHANNELS, CHANNELS, LIGHT_CHANNELS
from rfpp.imaging.radiance import log_decode
from rfpp.model.pixel_factors import PixelFactors
from rfpp.shards.views import select_views

BOUND = 0.7
#: Of the order of its maps.
KNOWN_DIFFUSE, KNOWN_GLOSSY, GATHERED_DIFFUSE, GATHERED_GLOSSY = range(PixelFactors.KINDS)
#: Channels that gathered light is made of.
OF_GATHERED = (BOUNCED_LIGHT, *CELL_CHANNELS)


def test_they_lie_between_their_bounds():
    factors = PixelFactors(width=8, bound=BOUND)
    torch.nn.init.normal_(factors.maps.weight, std=100.0)
    guides = torch.randn(2, 10, 12, 12, generator=torch.Generator().manual_seed(0))
    both = torch.cat(factors(guides), dim=1)
    assert both.min().item() == pytest.approx(math.exp(-BOUND))
    assert both.max().item() == pytest.approx(math.exp(BOUND))


def test_surroundings_count_not_the_pixel_alone():
    factors = PixelFactors(width=8, bound=BOUND)
    guides = torch.zeros(1, 10, 9, 9)
    changed = guides.clone()
    changed[..., 4, 4] = 1.0
    moved = (torch.cat(factors(changed), dim=1) != torch.cat(factors(guides), dim=1)).any(1)[0]
    assert moved[2:7, 2:7].all()
    assert moved.sum() == 25


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(0)
    return network("experiment=[quickstart,pixel_factors]")


@torch.no_grad()
def image(net, dark: tuple[str, ...] = (), logit: dict[int, float] | None = None) -> torch.Tensor:
    """Linear radiance of a stored sample with some of its light left out, and factors that are the same everywhere."""
    net.decoder.factors.maps.weight.zero_()
    net.decoder.factors.maps.bias.copy_(torch.tensor([(logit or {}).get(k, 0.0) for k in range(PixelFactors.KINDS)]))
    sample = stored_sample()
    views = select_views(sample, range(len(sample.fov)), net.gbuffer_channels)
    gbuffer, start = views.gbuffer.copy(), 0
    for name in net.gbuffer_channels:
        if name in dark:
            gbuffer[:, start : start + CHANNELS[name]] = -1 if name in CELL_CHANNELS else 0
        start += CHANNELS[name]
    return log_decode(net(RaggedBatch.pack([replace(views, gbuffer=gbuffer)])).log_radiance.double())


@pytest.mark.parametrize(
    ("kind", "lit"),
    [
        (KNOWN_DIFFUSE, ("direct_diffuse",)),
        (KNOWN_GLOSSY, ("direct_glossy",)),
        (GATHERED_DIFFUSE, (BOUNCED_LIGHT, "diffuse_cells", "diffuse_onward")),
        (GATHERED_GLOSSY, ("glossy_cells", "glossy_onward")),
    ],
)
def test_each_kind_of_light_has_a_factor_of_its_own(net, kind, lit):
    """Where no other light is, its factor is that of the image; and where it is dark, nothing changes."""
    others = tuple({*LIGHT_CHANNELS, *OF_GATHERED} - set(lit))
    alone = image(net, others)
    assert alone.max() > 0
    factor = math.exp(net.decoder.factors.bound * math.tanh(0.5))
    torch.testing.assert_close(image(net, others, {kind: 0.5}), factor * alone, rtol=1e-4, atol=1e-6)
    dark = (*lit, "reflected_light")  # which is known in part, and shared in part
    torch.testing.assert_close(image(net, dark, {kind: 0.5}), image(net, dark), rtol=1e-4, atol=1e-6)

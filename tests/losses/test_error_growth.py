"""Parts taken away: what each test of life does, and that it tells living parts from dead ones."""

from dataclasses import replace

import pytest
import torch
from network_variants import batch_for
from networks import network

from rfpp.losses.error_growth import (
    EXCHANGED_SCENE,
    EXCHANGED_TOKENS,
    NO_TRANSPORT,
    PERMUTED_LIGHT,
    Donation,
    ErrorGrowth,
    donated,
    impaired,
)
from rfpp.losses.log_l1 import log_l1

NETWORKS = {
    "paper": ("experiment=large_scale",),
    "known light": ("experiment=quickstart", "model=known_light"),
    "linear light": ("experiment=quickstart",),
    "RenderFormer": ("experiment=[large_scale,renderformer]",),
}


@pytest.fixture(params=NETWORKS.values(), ids=NETWORKS.keys())
def net(request):
    return network(*request.param)


def turned_over(donor: Donation) -> Donation:
    """With the scene tokens in another order, before light has moved and after."""
    tokens = donor.encoded.tokens
    encoded = replace(donor.encoded, tokens=replace(tokens, features=tokens.features.flip(0)))
    return Donation(donor.features.flip(0), encoded)


@torch.no_grad()
@pytest.mark.parametrize("what", [EXCHANGED_TOKENS, EXCHANGED_SCENE])
def test_a_scene_given_its_own_is_as_it_was(net, what):
    batch = batch_for(net, scenes=1)
    given = impaired(net, batch, donated(net, batch))[what]
    torch.testing.assert_close(given, net(batch).log_radiance)


@torch.no_grad()
def test_another_scene_s_tokens_show_in_a_network_that_reads_them(net):
    batch = batch_for(net)
    donor = donated(net, batch)
    few = replace(donor, features=donor.features.flip(0)[: len(donor.features) // 2])
    given = impaired(net, batch, few)[EXCHANGED_TOKENS]
    assert not torch.allclose(given, net(batch).log_radiance, rtol=1e-3, atol=1e-5)


@torch.no_grad()
def test_another_scene_s_light_shows_also_where_tokens_know_none():
    net = network("experiment=quickstart")
    one = batch_for(net, scenes=1)
    twice = replace(one, cells=one.cells.dimmed(torch.tensor([0.5])))
    brighter = impaired(net, one, donated(net, twice))
    torch.testing.assert_close(brighter[EXCHANGED_TOKENS], net(one).log_radiance)  # tokens know no light
    assert (brighter[EXCHANGED_SCENE] > net(one).log_radiance + 1e-5).float().mean() > 0.1


@torch.no_grad()
def test_and_not_in_one_that_does_not():
    net = network("experiment=quickstart", "model=known_light")
    for block in net.decoder.blocks:  # as training may leave them: rays look at nothing but rays
        block.cross_attention.out_proj.weight.zero_()
    batch = batch_for(net)
    parts = impaired(net, batch, turned_over(donated(net, batch)))
    for image in parts.values():
        torch.testing.assert_close(image, net(batch).log_radiance, rtol=0, atol=0)


@torch.no_grad()
def test_without_transport_nothing_is_transported():
    net = network("experiment=quickstart")
    batch = batch_for(net)
    batch = replace(batch, cells=replace(batch.cells, specular=torch.zeros_like(batch.cells.specular)))
    still = impaired(net, batch, donated(net, batch))[NO_TRANSPORT]
    blind = replace(batch.cells, hits=torch.full_like(batch.cells.hits, -1), highlights=0 * batch.cells.highlights)
    bright = replace(batch, cells=blind)
    torch.testing.assert_close(still, net(bright).log_radiance)  # cells that see none send on the first bounce alone


@torch.no_grad()
def test_light_is_dealt_within_a_scene():
    net = network("experiment=quickstart")
    batch = batch_for(net)
    images = impaired(net, batch, donated(net, batch))
    dark = batch.cells.arriving.clone()
    dark[: batch.cells.scenes.lengths[0]] = 0
    half = impaired(net, replace(batch, cells=replace(batch.cells, arriving=dark)), donated(net, batch))
    torch.testing.assert_close(half[PERMUTED_LIGHT][1], images[PERMUTED_LIGHT][1])
    assert not torch.allclose(half[PERMUTED_LIGHT][0], images[PERMUTED_LIGHT][0], rtol=1e-4, atol=1e-7)


def test_a_network_without_an_operator_has_none_to_take_away():
    net = network("experiment=[large_scale,renderformer]")
    batch = batch_for(net)
    with torch.no_grad():
        assert set(impaired(net, batch, donated(net, batch))) == {EXCHANGED_TOKENS, EXCHANGED_SCENE}


@torch.no_grad()
def test_growth_is_a_share_of_the_error_and_needs_another_scene():
    net, growth = network("experiment=quickstart"), ErrorGrowth()
    for scenes in (1, 2):  # the second time the last scene is another one
        batch = batch_for(net, scenes=scenes)
        growth.add(net, batch, net(batch).log_radiance)
        if scenes == 1:
            assert growth.shares() == {}
    dark = impaired(net, batch, donated(net, batch_for(net, scenes=1)))
    expected = log_l1(dark[NO_TRANSPORT], batch.image) / log_l1(net(batch).log_radiance, batch.image) - 1
    assert growth.shares()[NO_TRANSPORT] == pytest.approx(expected.item(), rel=1e-4)

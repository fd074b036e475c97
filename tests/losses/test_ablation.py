import pytest
import torch
from network_variants import batch_for
from networks import network

from rfpp.losses.ablation import (
    NO_OPERATOR,
    OTHER_ENCODED_TOKENS,
    OTHER_TOKENS,
    AblationErrors,
    TokenFeatures,
    ablated,
    token_spread,
)
from rfpp.losses.log_l1 import log_l1

PAPER = "experiment=large_scale"
RENDERFORMER = "experiment=[large_scale,paper/renderformer]"


def flipped(other: TokenFeatures) -> TokenFeatures:
    return TokenFeatures(other.tokens.flip(0), other.encoded.flip(0))


@torch.no_grad()
@pytest.mark.parametrize("experiment", [PAPER, RENDERFORMER])
@pytest.mark.parametrize("ablation", [OTHER_TOKENS, OTHER_ENCODED_TOKENS])
def test_own_tokens_leave_the_image_unchanged(experiment, ablation):
    net = network(experiment)
    batch = batch_for(net)
    image = ablated(net, batch, TokenFeatures.of(net, batch))[ablation]
    torch.testing.assert_close(image, net(batch).log_radiance)


@torch.no_grad()
@pytest.mark.parametrize("ablation", [OTHER_TOKENS, OTHER_ENCODED_TOKENS])
def test_other_tokens_change_the_image_even_if_there_are_fewer(ablation):
    net = network(PAPER)
    batch, fewer = batch_for(net), TokenFeatures.of(net, batch_for(net, sizes=((14, 6, 1),)))
    image = ablated(net, batch, flipped(fewer))[ablation]
    assert not torch.allclose(image, net(batch).log_radiance, rtol=1e-3, atol=1e-5)


@torch.no_grad()
def test_a_decoder_that_ignores_tokens_is_unaffected():
    net = network(PAPER)
    for block in net.decoder.blocks:
        block.cross_attention.out_proj.weight.zero_()
    batch = batch_for(net)
    for image in ablated(net, batch, flipped(TokenFeatures.of(net, batch))).values():
        torch.testing.assert_close(image, net(batch).log_radiance, rtol=0, atol=0)


@torch.no_grad()
def test_no_operator_decodes_the_state_before_the_first_application():
    net = network(PAPER)
    batch = batch_for(net)
    (scenes, *_), _ = net.transported_each(*net.tokenize(batch), 2)
    first = net.view(scenes, batch.c2w, batch.fov, batch.gbuffer)
    image = ablated(net, batch, TokenFeatures.of(net, batch))[NO_OPERATOR]
    torch.testing.assert_close(image, first)
    assert not torch.allclose(image, net(batch).log_radiance, rtol=1e-3, atol=1e-5)


@torch.no_grad()
def test_a_network_without_an_operator_has_no_such_ablation():
    net = network(RENDERFORMER)
    batch = batch_for(net)
    assert set(ablated(net, batch, TokenFeatures.of(net, batch))) == {OTHER_TOKENS, OTHER_ENCODED_TOKENS}


@torch.no_grad()
def test_growth_compares_with_the_unmodified_error_and_needs_a_batch_before():
    net, errors = network(PAPER), AblationErrors()
    first, second = batch_for(net, sizes=((14, 6, 1),)), batch_for(net)
    errors.add(net, first, net(first).log_radiance)
    assert errors.growth() == {}
    errors.add(net, second, net(second).log_radiance)
    growth = errors.growth()
    unmodified = log_l1(net(second).log_radiance, second.image)
    for name, image in ablated(net, second, TokenFeatures.of(net, first)).items():
        assert growth[name] == pytest.approx((log_l1(image, second.image) / unmodified - 1).item(), rel=1e-4)


@torch.no_grad()
def test_the_spread_is_the_share_of_tokens_that_is_not_common_to_all():
    own = torch.randn(1000, 54, generator=torch.Generator().manual_seed(0))
    common = own.roll(1, 1)[:1]
    assert token_spread(own).item() == pytest.approx(1, abs=0.01)
    assert token_spread(own + 10 * common / common.square().mean().sqrt()).item() == pytest.approx(1 / 101, rel=0.1)
    assert token_spread(common.expand(1000, 54)).item() == pytest.approx(0, abs=1e-6)
    net, errors = network(PAPER), AblationErrors()
    batch = batch_for(net)
    errors.add(net, batch, net(batch).log_radiance)
    assert errors.spread() == pytest.approx(token_spread(net.tokenize(batch)[1].features).item())
    assert errors.spread() > 0.2  # before training

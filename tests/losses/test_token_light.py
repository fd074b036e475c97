import pytest
import torch
from network_variants import loss

from rfpp.errors import UserError
from rfpp.imaging.radiance import log_encode
from rfpp.losses.rendering import RenderingLoss
from rfpp.losses.token_light import TokenLight

LIGHT = torch.rand(16, 4, 3, generator=torch.Generator().manual_seed(0))


def states(count=4):
    """States whose first channels are the logarithm of the light after 1, 2, … bounces."""
    return [torch.cat([log_encode(LIGHT[:, min(k, 3)]), torch.ones(16, 5)], dim=1) for k in range(1, count + 1)]


def decoder() -> TokenLight:
    made = TokenLight(8)
    with torch.no_grad():
        made.decode.weight.copy_(torch.eye(3, 8))
        made.decode.bias.zero_()
    return made


def test_tokens_that_hold_the_light_have_no_loss():
    assert decoder()(states(), LIGHT) < 1e-6
    later = states()[1:] + states()[-1:]
    assert decoder()(later, LIGHT) > 0.01  # light of another bounce


def test_tokens_without_a_surface_do_not_count():
    unknown = LIGHT.clone()
    unknown[3] = torch.nan
    wrong = [state.clone() for state in states()]
    for state in wrong:
        state[3] = 100.0
    wrong[0].requires_grad_()
    found = decoder()(wrong, unknown)
    found.backward()
    assert found < 1e-6
    assert wrong[0].grad.isfinite().all()


def test_the_term_is_weighted_and_trained():
    weighted = RenderingLoss(1.0, 0.0, 0.0, None, False, token_light=TokenLight(8), token_light_weight=0.5)
    images = torch.rand(1, 1, 3, 4, 4)
    terms = weighted(images, tuple(states()), images, token_light=LIGHT)
    assert terms["loss"].item() == pytest.approx((terms["l1"] + 0.5 * terms["token_light"]).item())
    terms["loss"].backward()
    assert all(p.grad is not None for p in weighted.parameters())
    assert "token_light" not in loss()(images, tuple(states()), images, token_light=LIGHT)


def test_data_without_light_of_tokens_is_refused():
    weighted = RenderingLoss(1.0, 0.0, 0.0, None, False, token_light=TokenLight(8), token_light_weight=0.5)
    with pytest.raises(UserError, match="generate it with reference=radiosity"):
        weighted(torch.rand(1, 1, 3, 4, 4), tuple(states()), torch.rand(1, 1, 3, 4, 4))

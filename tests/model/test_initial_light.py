"""What starts the transport: emitted light, or the first bounce in its place."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.model.initial_light import EmittedLight, FirstBounce

FIRST_BOUNCE = "model.source._target_=rfpp.model.initial_light.FirstBounce"
LIGHT = np.array([[0.5, 0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], np.float32)


@pytest.fixture
def batch() -> RaggedBatch:
    """Two scenes of two objects and a light."""
    seeds = (np.random.default_rng(0), np.random.default_rng(1))
    return RaggedBatch.pack(
        [replace(random_views(rng), object_light=LIGHT * factor) for factor, rng in enumerate(seeds, 1)]
    )


def test_tokens_start_with_what_their_object_emits_or_with_what_it_sends_on(batch):
    net = network()
    emitted = net.tokens(batch)
    assert EmittedLight()(emitted, batch) is emitted
    lit = FirstBounce()(emitted, batch)
    light = torch.from_numpy(np.concatenate([LIGHT, 2 * LIGHT])) / FirstBounce.FLOOR
    torch.testing.assert_close(lit.log_light, log_encode(light).repeat_interleave(8, 0))
    assert torch.equal(lit.features, emitted.features) and torch.equal(lit.points, emitted.points)


def test_the_image_follows_the_first_bounce_only_where_the_network_starts_from_it(batch):
    other = replace(batch, object_light=batch.object_light + 0.1)
    for overrides, follows in (((), False), ((FIRST_BOUNCE,), True)):
        net = network(*overrides)
        assert torch.equal(net(batch).log_radiance, net(other).log_radiance) is not follows


def test_twice_the_light_is_twice_the_image_at_the_exposure_of_the_lights(batch):
    net = network(FIRST_BOUNCE, "model.exposure._target_=rfpp.model.exposure.MeanIrradianceExposure")
    material = batch.material.clone()
    material[:, 7:] *= 2
    brighter = replace(batch, material=material, object_light=2 * batch.object_light)
    exposure, tokens = net.tokenize(batch)
    twice, same = net.tokenize(brighter)
    torch.testing.assert_close(twice, 2 * exposure)
    torch.testing.assert_close(same.log_light, tokens.log_light)


def test_tokens_of_triangles_are_refused(batch):
    with pytest.raises(ValueError, match="something else"):
        network("model=renderformer", FIRST_BOUNCE)(batch)


def test_a_batch_without_it_says_so(batch):
    with pytest.raises(ValueError, match="object_light"):
        network(FIRST_BOUNCE)(replace(batch, object_light=None))

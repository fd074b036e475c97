"""The stages: what reaches the image, what each refuses, how large they are."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.losses.transport_consistency import TransportConsistency
from rfpp.model.hoct import mean_by_object, object_anchors
from rfpp.model.layers.block import RMSNorm
from rfpp.model.layers.encoding import RelativeSpatialEncoding, rotate
from rfpp.model.pitg import EmissionEncoder
from rfpp.segments import Segments


@pytest.fixture
def batch():
    return RaggedBatch.pack([random_views(np.random.default_rng(0), (14, 6, 1)) for _ in range(2)])


def test_image_depends_on_every_input(batch):
    net = network()
    inputs = {
        name: getattr(batch, name).clone().requires_grad_()
        for name in ("positions", "normals", "material", "c2w", "fov", "gbuffer")
    }
    net(replace(batch, **inputs)).log_radiance.sum().backward()
    for name, value in inputs.items():
        assert value.grad.abs().max() > 0, f"the image ignores {name}"
    per_column = inputs["material"].grad.abs().amax(0)
    assert (per_column > 0).all()


def test_every_parameter_learns(batch):
    net = network().train()
    rendering = net(batch)
    loss = rendering.log_radiance.mean() + TransportConsistency()(rendering.transport_states).sum()
    loss.backward()
    idle = [name for name, p in net.named_parameters() if p.grad is None or not p.grad.abs().max() > 0]
    assert idle == []


def test_inputs_are_left_alone(batch):
    before = {k: v.clone() for k, v in vars(batch).items() if isinstance(v, torch.Tensor)}
    network()(batch)
    for name, value in before.items():
        assert torch.equal(getattr(batch, name), value)


def test_resolution_may_differ_from_training_and_need_not_be_square():
    views = random_views(np.random.default_rng(1), resolution=16)
    wide = replace(views, gbuffer=np.zeros((2, 7, 8, 20), np.float32), image=None)
    assert network()(RaggedBatch.pack([wide])).log_radiance.shape == (1, 2, 3, 8, 20)


def test_a_resolution_that_does_not_divide_into_patches_is_refused():
    views = replace(random_views(np.random.default_rng(1)), gbuffer=np.zeros((2, 7, 10, 16), np.float32), image=None)
    with pytest.raises(ValueError, match="16×10 pixels do not divide into patches of 4"):
        network()(RaggedBatch.pack([views]))


def test_other_gbuffer_channels_than_trained_with_are_refused():
    with pytest.raises(ValueError, match="4 G-buffer channels"):
        network()(RaggedBatch.pack([random_views(np.random.default_rng(1), channels=4)]))


@pytest.mark.parametrize("iterations", [1, 3, 5])
def test_transport_states_of_training_and_inference(batch, iterations):
    net = network(f"model.transport.iterations={iterations}")
    assert len(net(batch).transport_states) == iterations
    trained = net.train()(batch).transport_states
    assert len(trained) == iterations + 1
    residuals = TransportConsistency()(trained)
    assert residuals.shape == (iterations,)
    assert (residuals > 0).all()


def test_transport_states_cannot_shrink(batch):
    net = network().train()
    with torch.no_grad():
        for parameter in net.transport.parameters():
            parameter.mul_(0.1)
    for state in net(batch).transport_states:
        torch.testing.assert_close(state.square().mean(-1), torch.ones(len(state)), rtol=1e-2, atol=1e-2)


def test_consistency_residual_is_the_mean_square_and_vanishes_at_a_fixed_point():
    a, b = torch.zeros(4, 6), torch.full((4, 6), 0.5)
    torch.testing.assert_close(TransportConsistency()([a, b, b]), torch.tensor([0.25, 0.0]))


def test_scenes_of_a_batch_weigh_the_same_in_the_consistency_residual():
    states = list(torch.randn(2, 7, 6))
    apart = [TransportConsistency()([state[rows] for state in states]) for rows in (slice(0, 2), slice(2, 7))]
    together = TransportConsistency()(states, Segments.from_lengths([2, 5]))
    torch.testing.assert_close(together, sum(apart) / 2)


def test_no_emission_is_exactly_zero_emission_features():
    encoder = EmissionEncoder(8)
    emitted, scattered = encoder(torch.randn(5, 8), torch.zeros(5, 3))
    assert torch.equal(emitted, scattered)


def test_anchor_is_bounding_box_and_area_weighted_centroid():
    views = random_views(np.random.default_rng(3), (2, 1))
    corners = np.array([[[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]], np.float32)
    positions = np.concatenate([corners, corners[:1] + 5])
    batch = RaggedBatch.pack([replace(views, triangles=replace(views.triangles, positions=positions))])
    first = object_anchors(batch)[0]
    centroid = (corners[0].mean(0) * 2 + corners[1].mean(0) * 0.5) / 2.5  # areas 2 and 1/2
    np.testing.assert_allclose(first[:3], [0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(first[3:6], centroid, rtol=1e-5)
    np.testing.assert_allclose(first[6:], [2, 2, 1], rtol=1e-6)
    torch.testing.assert_close(mean_by_object(torch.ones(3, 1), batch), torch.ones(2, 1))


def test_rotary_scores_depend_on_differences_only():
    rope = RelativeSpatialEncoding(head_dim=54, num_frequencies=3)
    q, k = torch.randn(1, 1, 54), torch.randn(1, 1, 54)
    a, b, shift = torch.rand(1, 9), torch.rand(1, 9), torch.full((1, 9), 0.8)

    def score(x, y):
        return (rotate(q, rope(x)) * rotate(k, rope(y))).sum()

    torch.testing.assert_close(score(a + shift, b + shift), score(a, b), rtol=1e-4, atol=1e-5)
    assert not torch.allclose(score(a + shift, b), score(a, b), rtol=1e-3)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_rms_norm_of_small_values_does_not_depend_on_the_dtype(dtype):
    """PyTorch's default eps is that of the dtype, which is larger than what it is added to here."""
    norm, x = RMSNorm(64), 0.01 * torch.randn(3, 64)
    torch.testing.assert_close(norm.to(dtype)(x.to(dtype)).float(), norm.float()(x), rtol=0.02, atol=0.02)


def test_rotation_gradient_is_its_transpose():
    rotation = RelativeSpatialEncoding(18, 1)(torch.rand(3, 9).double())
    x = torch.randn(3, 2, 18, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: rotate(t, rotation), (x,), atol=1e-4, rtol=1e-4)

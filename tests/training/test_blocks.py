"""Compiled blocks and blocks that compute twice: the same network, other time and memory."""

import pytest
import torch
from compiled_gradients import batches, compare, gradients
from networks import network

from rfpp.errors import UserError
from rfpp.training.blocks import RecomputedBlocks, RecomputedObjects


@pytest.mark.parametrize(("policy", "share"), [(RecomputedBlocks(), 0.6), (RecomputedObjects(15), 0.4)])
def test_activations_computed_twice_give_the_same_gradients(policy, share):
    net, frugal = (network("experiment=large_scale", "size=tiny").train() for _ in range(2))
    policy(frugal)
    batch = batches()[0]
    kept = []
    for each in (net, frugal):
        sizes = []
        with torch.autograd.graph.saved_tensors_hooks(lambda t, to=sizes: to.append(t.numel()) or t, lambda t: t):
            each(batch)
        kept.append(sum(sizes))
    assert kept[1] < share * kept[0]
    expected = gradients(net, batch)
    for name, gradient in gradients(frugal, batch).items():
        torch.testing.assert_close(gradient, expected[name], rtol=1e-4, atol=1e-6, msg=name)


def test_a_network_without_object_tokens_cannot_be_taken_object_by_object():
    with pytest.raises(UserError, match="choose blocks"):
        RecomputedObjects(60)(network("experiment=[large_scale,paper/renderformer]"))


def test_compiled_blocks_give_the_same_gradients_for_any_number_of_tokens(in_process):
    differences, compilations = in_process(compare)
    assert max(differences) < 1e-4
    assert compilations[0] > 0
    assert compilations[-1] == compilations[1], "other numbers of tokens are compiled anew"

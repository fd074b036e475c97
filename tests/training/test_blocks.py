"""Compiled blocks and blocks that compute twice: the same network, other time and memory."""

import torch
from compiled_gradients import batches, compare, gradients
from networks import network

from rfpp.training.blocks import checkpoint_activations


def test_activations_computed_twice_give_the_same_gradients():
    net, frugal = (network("+experiment=large_scale", "size=tiny").train() for _ in range(2))
    checkpoint_activations(frugal)
    batch = batches()[0]
    kept = []
    for each in (net, frugal):
        sizes = []
        with torch.autograd.graph.saved_tensors_hooks(lambda t, to=sizes: to.append(t.numel()) or t, lambda t: t):
            each(batch)
        kept.append(sum(sizes))
    assert kept[1] < 0.6 * kept[0]
    expected = gradients(net, batch)
    for name, gradient in gradients(frugal, batch).items():
        assert torch.equal(gradient, expected[name]), name


def test_compiled_blocks_give_the_same_gradients_for_any_number_of_tokens(in_process):
    differences, compilations = in_process(compare)
    assert max(differences) < 1e-4
    assert compilations[0] > 0
    assert compilations[-1] == compilations[1], "other numbers of tokens are compiled anew"

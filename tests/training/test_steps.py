from collections import Counter

import numpy as np
import pytest
import torch
from network_variants import VARIANTS, batch_for, loss
from networks import network
from torch.utils._python_dispatch import TorchDispatchMode

from rfpp.batch import common_size
from rfpp.model.layers.matrix_precision import block_weights
from rfpp.training import steps
from rfpp.training.steps import PlainStep


def gradients(net, batch) -> dict[str, torch.Tensor]:
    net.zero_grad()
    terms, _ = PlainStep()(net, loss(), batch)
    terms["loss"].backward()
    terms = {f"term {name}": term.detach() for name, term in terms.items()}
    return terms | {name: p.grad.clone() for name, p in net.named_parameters() if p.grad is not None}


def as_on_a_gpu(batch):
    """The batch that a CUDA graph sees: the host knows no length of it."""
    return batch.with_tensors(batch.tensors())


@pytest.mark.parametrize("sizes", [((14, 6, 1), (3, 9, 2, 1, 2)), ((14, 6, 1), (3, 9, 2, 1))], ids=["more", "none"])
@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS.keys())
def test_a_padded_batch_has_the_same_losses_and_gradients(variant, sizes):
    torch.manual_seed(0)
    net = network(*variant).train()
    batch = batch_for(net, resolution=32, sizes=sizes)
    padded = batch.padded()
    assert len(padded.scenes) == len(batch.scenes) + 1
    assert (len(padded.positions), len(padded.objects)) == ((40, 10) if len(sizes[1]) == 5 else (36, 7))
    expected = gradients(net, batch)
    for found in (gradients(net, padded), gradients(net, as_on_a_gpu(padded))):
        assert found.keys() == expected.keys()
        for name, right in expected.items():
            assert float((found[name] - right).norm()) <= 1e-4 * float(right.norm()) + 1e-7, name


def test_padded_sizes_recur():
    sizes = {common_size(n) for n in range(1024, 2048)}
    assert len(sizes) == 9
    assert len({common_size(n, 4) for n in range(64, 128)}) == 5
    assert all(n <= common_size(n) <= 1.125 * n for n in range(1, 5000))


def test_the_padding_is_in_its_own_scene_and_has_an_area():
    net = network(*VARIANTS["paper"])
    padded = batch_for(net, resolution=32, sizes=((14, 6, 1), (3, 9, 2, 1, 2))).padded()
    real = sum(padded.scenes.lengths[:-1])
    assert (padded.objects.index[padded.areas > 0]).unique().numel() == len(padded.objects)
    assert padded.material[sum(padded.objects.lengths[:real]) :].abs().sum() == 0
    assert padded.objects.longest >= max(padded.objects.lengths)
    assert np.log2(padded.objects.longest) % 1 == 0


class Repeated:
    """In place of a CUDA graph: a function that is called again."""

    def __init__(self, function, inputs, pool):
        self.function, self.pool = function, pool
        function(*inputs)

    def __call__(self, *inputs):
        return self.function(*inputs)


@pytest.fixture
def graphs_repeat(monkeypatch):
    monkeypatch.setattr(steps, "CudaGraph", Repeated)
    monkeypatch.setattr(torch.cuda, "graph_pool_handle", lambda: (0, 0))


@pytest.mark.usefixtures("graphs_repeat")
@pytest.mark.parametrize("variant", ["paper", "renderformer", "known_light"])
def test_a_captured_step_gives_autograd_the_gradients_of_the_plain_one(variant):
    torch.manual_seed(0)
    net, captured = network(*VARIANTS[variant]).train(), steps.CapturedStep()
    for sizes in (((14, 6, 1), (3, 9, 2, 1, 2)), ((13, 6, 2), (4, 7, 2, 2, 1))):
        batch = batch_for(net, resolution=32, sizes=sizes)
        expected = gradients(net, batch)
        net.zero_grad()
        terms, tokens = captured(net, loss(), batch.padded())
        (0.5 * terms["loss"]).backward()
        assert tokens >= 8 * len(batch.objects) or variant == "renderformer"
        for name, term in terms.items():
            assert float(term) == pytest.approx(float(expected[f"term {name}"]), rel=1e-4)
        for name, p in net.named_parameters():
            assert (p.grad is None) == (name not in expected)
            if p.grad is not None:
                difference = float((2 * p.grad - expected[name]).norm())
                assert difference <= 1e-4 * float(expected[name].norm()) + 1e-7, name
    assert len(captured._graphs) == 1


class Conversions(TorchDispatchMode):
    """Counts conversions to bfloat16 by the storage that is converted."""

    def __init__(self):
        super().__init__()
        self.of = Counter()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if func is torch.ops.aten._to_copy.default and kwargs.get("dtype") == torch.bfloat16:
            self.of[args[0].untyped_storage().data_ptr()] += 1
        return func(*args, **kwargs or {})


@pytest.mark.usefixtures("graphs_repeat")
@pytest.mark.parametrize("variant", ["paper", "renderformer"])
def test_a_captured_step_converts_each_weight_of_a_block_once(variant):
    """In the operator and in the backward pass too; graphs cannot use autocast's cache."""
    torch.manual_seed(0)
    net = network(*VARIANTS[variant]).train()
    batch = batch_for(net, resolution=32)
    with torch.autocast("cpu", torch.bfloat16, cache_enabled=False), Conversions() as conversions:
        terms, _ = steps.CapturedStep()(net, loss(), batch.padded())
    terms["loss"].backward()
    weights = {name: p for name, p in net.named_parameters() if name in block_weights(net)}
    executions = 2
    counts = {name: conversions.of[p.untyped_storage().data_ptr()] for name, p in weights.items()}
    assert counts == dict.fromkeys(weights, executions)

    found = {name: p.grad.clone() for name, p in net.named_parameters() if p.grad is not None}
    with torch.autocast("cpu", torch.bfloat16):
        expected = gradients(net, batch)
    for name, gradient in found.items():
        assert gradient.dtype == torch.float32
        assert float((gradient - expected[name]).norm()) <= 0.03 * float(expected[name].norm()) + 1e-6, name

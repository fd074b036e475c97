"""Layers that compute again what they could keep: values and gradients are those of the plain formula."""

import pytest
import torch
import torch.nn.functional as F

from rfpp.model.dpt import ResidualConvUnit
from rfpp.model.layers.block import SwiGLU


def plain_swiglu(layer: SwiGLU, x: torch.Tensor) -> torch.Tensor:
    gate, value = (F.linear(x, weight) for weight in layer.in_proj.weight.chunk(2))
    return layer.out_proj(F.silu(gate) * value)


def plain_unit(layer: ResidualConvUnit, x: torch.Tensor) -> torch.Tensor:
    return x + layer.conv2(F.silu(layer.conv1(F.silu(x))))


LAYERS = {
    "SwiGLU": (lambda: SwiGLU(32, 96), plain_swiglu, (50, 32)),
    "ResidualConvUnit": (lambda: ResidualConvUnit(8), plain_unit, (2, 8, 7, 5)),
}


def values_and_gradients(layer, forward, x, dtype):
    layer.zero_grad()
    x = x.clone().requires_grad_()
    with torch.autocast("cpu", dtype, enabled=dtype != torch.float32):
        y = forward(x)
    (y.float() * torch.linspace(-1, 1, y.numel()).view(y.shape)).sum().backward()
    return [y.detach(), x.grad, *(p.grad for p in layer.parameters())]


@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize(("dtype", "input_dtype"), [("float32", "float32"), ("bfloat16", "float32"), ("bfloat16",) * 2])
def test_values_and_gradients_are_those_of_the_formula(name, dtype, input_dtype):
    make, plain, shape = LAYERS[name]
    torch.manual_seed(0)
    layer, x = make(), torch.randn(shape).to(getattr(torch, input_dtype))
    found = values_and_gradients(layer, layer, x, getattr(torch, dtype))
    expected = values_and_gradients(layer, lambda x: plain(layer, x), x, getattr(torch, dtype))
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.dtype == theirs.dtype
        assert theirs.abs().max() > 0
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6 * float(theirs.abs().max()))


def saved_bytes(layer, forward, x) -> int:
    """Bytes of activations that autograd saves, without the parameters."""
    parameters = {parameter.data_ptr() for parameter in layer.parameters()}
    saved = {}  # by address; holding the tensors keeps addresses from being reused

    def pack(tensor):
        saved[tensor.untyped_storage().data_ptr()] = tensor
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        forward(x)
    return sum(t.untyped_storage().nbytes() for address, t in saved.items() if address not in parameters)


@pytest.mark.parametrize(("name", "kept"), [("SwiGLU", 50 * (32 + 96 + 96)), ("ResidualConvUnit", 2 * 2 * 8 * 7 * 5)])
def test_nothing_else_is_kept(name, kept):
    make, plain, shape = LAYERS[name]
    layer, x = make(), torch.randn(shape, requires_grad=True)
    count = saved_bytes(layer, layer, x)
    assert count == 4 * kept
    assert saved_bytes(layer, lambda x: plain(layer, x), x) >= 4 / 3 * count

import copy

import numpy as np
import pytest
import torch
from torch import nn

from rfpp.metrics.lpips import LPIPS
from rfpp.metrics.lpips_weights import CONV_CHANNELS, linear_weights


def _images(seed: int, n: int = 2, size: int = 32) -> torch.Tensor:
    return 2 * torch.rand(n, 3, size, size, generator=torch.Generator().manual_seed(seed)) - 1


def _written_out(trunk: dict, linear: list, a: torch.Tensor, b: torch.Tensor) -> float:
    """The metric of one pair in float64, layer by layer as the paper states it."""
    names = iter(CONV_CHANNELS)
    shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    x, y = (torch.tensor((image.numpy().transpose(1, 2, 0) - shift) / scale).permute(2, 0, 1)[None] for image in (a, b))
    distance = 0.0
    for stage, depth in enumerate([2, 2, 3, 3, 3]):
        if stage:
            x, y = nn.MaxPool2d(2, 2)(x), nn.MaxPool2d(2, 2)(y)
        for name in [next(names) for _ in range(depth)]:
            weight, bias = trunk[f"{name}.weight"].double(), trunk[f"{name}.bias"].double()
            x, y = (nn.ReLU()(nn.functional.conv2d(z, weight, bias, padding=1)) for z in (x, y))
        f, g = (z[0].permute(1, 2, 0).numpy() for z in (x, y))
        f, g = (z / np.maximum(np.linalg.norm(z, axis=-1, keepdims=True), 1e-10) for z in (f, g))
        distance += ((f - g) ** 2 @ linear[stage].double().numpy()).mean()
    return float(distance)


def test_equals_the_formula_written_out(random_trunk, random_lpips) -> None:
    a, b = _images(0), _images(1)
    expected = [_written_out(random_trunk, linear_weights(), x, y) for x, y in zip(a, b, strict=True)]
    torch.testing.assert_close(random_lpips(a, b), torch.tensor(expected), rtol=1e-4, atol=1e-6)


def test_pretrained_values_do_not_move(pretrained_lpips) -> None:
    rows = torch.linspace(-1, 1, 64)
    gradient = rows.expand(1, 3, 64, 64).contiguous()
    checks = torch.sign(torch.sin(20 * rows))[:, None] * torch.sign(torch.sin(20 * rows))
    values = pretrained_lpips(torch.cat([gradient, gradient]), torch.cat([gradient.mT, checks.expand(1, 3, 64, 64)]))
    torch.testing.assert_close(values, torch.tensor([0.517032, 0.674328]), rtol=1e-3, atol=0)


def test_is_zero_for_equal_images_and_symmetric(random_lpips) -> None:
    a, b = _images(0), _images(1)
    assert random_lpips(a, a).abs().max() == 0
    torch.testing.assert_close(random_lpips(a, b), random_lpips(b, a))


def test_gradient_matches_a_finite_difference(random_lpips) -> None:
    a, b = _images(0, n=1, size=16), _images(1, n=1, size=16)
    direction = _images(2, n=1, size=16)
    a.requires_grad_()
    random_lpips(a, b).sum().backward()
    step = 1e-3
    with torch.no_grad():
        slope = (random_lpips(a + step * direction, b) - random_lpips(a - step * direction, b)) / (2 * step)
    assert a.grad.abs().max() > 0
    torch.testing.assert_close((a.grad * direction).sum()[None], slope, rtol=0.05, atol=1e-4)


def test_gradient_is_finite_where_all_features_vanish(random_trunk) -> None:
    dead = {k: v if k.endswith("weight") else torch.full_like(v, -100.0) for k, v in random_trunk.items()}
    image = _images(0, n=1, size=16).requires_grad_()
    LPIPS(dead, linear_weights())(image, _images(1, n=1, size=16)).sum().backward()
    assert image.grad.isfinite().all()


def test_is_float32_under_bf16_autocast(random_lpips) -> None:
    a, b = _images(0), _images(1)
    expected = random_lpips(a, b)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(random_lpips(a, b), expected)
    assert random_lpips(a.bfloat16(), b.bfloat16()).dtype == torch.float32


def test_leaves_no_trace_in_its_owner(random_lpips) -> None:
    owner = nn.Linear(2, 2)
    owner.lpips = random_lpips
    assert set(owner.state_dict()) == {"weight", "bias"}
    assert len(list(owner.parameters())) == 2
    assert not list(owner.buffers())


def test_modes_and_casts_of_the_owner_do_not_reach_it(random_lpips) -> None:
    owner = nn.Module()
    owner.lpips = copy.deepcopy(random_lpips)
    a, b = _images(0), _images(1)
    owner.train().bfloat16()
    assert torch.equal(owner.lpips(a, b), random_lpips(a, b))


def test_frozen_trunk_gathers_no_gradient(random_lpips) -> None:
    random_lpips(_images(0).requires_grad_(), _images(1)).sum().backward()
    assert all(not w.requires_grad and w.grad is None for pair in random_lpips._convolutions for w in pair)


def test_too_small_images_are_refused(random_lpips) -> None:
    with pytest.raises(ValueError, match="16 pixels"):
        random_lpips(_images(0, size=8), _images(1, size=8))

import copy

import lpips
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from rfpp.errors import MissingDependencyError
from rfpp.metrics.lpips import LPIPS, TRUNK, load_trunk, trunk_file


def _images(seed: int, n: int = 2, size: int = 16) -> torch.Tensor:
    return 2 * torch.rand(n, 3, size, size, generator=torch.Generator().manual_seed(seed)) - 1


def _of_the_package(trunk: dict) -> lpips.LPIPS:
    network = lpips.LPIPS(net="vgg", pnet_rand=True, verbose=False)
    network.net.load_state_dict(dict(zip(network.net.state_dict(), trunk.values(), strict=True)))
    return network


def test_equals_the_forward_of_the_package_in_value_and_gradient(random_trunk, random_lpips) -> None:
    theirs, (a, b) = _of_the_package(random_trunk), (_images(0), _images(1))
    values, gradients = [], []
    for metric in (random_lpips, theirs):
        image = a.clone().requires_grad_()
        values.append(metric(image, b).flatten())
        values[-1].sum().backward()
        gradients.append(image.grad)
    torch.testing.assert_close(*values)
    torch.testing.assert_close(*gradients, rtol=1e-3, atol=1e-6)


def test_pretrained_values_do_not_move(pretrained_lpips) -> None:
    rows = torch.linspace(-1, 1, 64)
    gradient = rows.expand(1, 3, 64, 64).contiguous()
    checks = torch.sign(torch.sin(20 * rows))[:, None] * torch.sign(torch.sin(20 * rows))
    values = pretrained_lpips(torch.cat([gradient, gradient]), torch.cat([gradient.mT, checks.expand(1, 3, 64, 64)]))
    torch.testing.assert_close(values, torch.tensor([0.517032, 0.674328]), rtol=1e-3, atol=0)


def test_gradient_is_finite_where_all_features_vanish(random_trunk) -> None:
    dead = {k: v if k.endswith("weight") else torch.full_like(v, -100.0) for k, v in random_trunk.items()}
    image = _images(0, n=1, size=16).requires_grad_()
    LPIPS(dead)(image, _images(1, n=1, size=16)).sum().backward()
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


def test_construction_draws_no_random_numbers(random_trunk) -> None:
    before = torch.get_rng_state()
    LPIPS(random_trunk)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("damage", ["missing", "cut off", "other values", "other network"])
def test_an_invalid_cache_names_the_command_in_one_line(tmp_path, monkeypatch, random_trunk, damage) -> None:
    trunk = load_trunk()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    trunk_file().parent.mkdir()
    if damage == "cut off":
        save_file(trunk, trunk_file())
        trunk_file().write_bytes(trunk_file().read_bytes()[:5000])
    elif damage == "other values":
        save_file(random_trunk, trunk_file())
    elif damage == "other network":
        save_file({TRUNK[0]: trunk[TRUNK[0]]}, trunk_file())
    with pytest.raises(MissingDependencyError, match="vgg16-trunk.safetensors: .*`rfpp weights`") as error:
        load_trunk()
    assert "\n" not in str(error.value)

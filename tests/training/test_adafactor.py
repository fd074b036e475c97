"""Adafactor: a state that weighs next to nothing, and weights that learn with it."""

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from network_variants import loss
from networks import checkpoint_info, network
from torch import nn

from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.metrics.image import ImageMetrics
from rfpp.training.module import RenderingModule, decay_groups


def made(name, *overrides):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("train", overrides=["run_dir=unused", f"optimizer={name}", *overrides])
    return instantiate(cfg.optimizer, _convert_="all")


def steps(net, optimizer, count):
    x = torch.randn(64, 32, generator=torch.Generator().manual_seed(0))
    losses = []
    for _ in range(count):
        error = (net(x)[:, 0] - x[:, 0] * x[:, 1]).square().mean()
        optimizer.zero_grad()
        error.backward()
        optimizer.step()
        losses.append(float(error.detach()))
    return losses


def test_it_learns_with_a_state_of_a_few_percent_of_its_weights():
    torch.manual_seed(0)
    net = nn.Sequential(nn.Linear(32, 256), nn.SiLU(), nn.Linear(256, 256), nn.SiLU(), nn.Linear(256, 1))
    sizes = {}
    for name in ("adamw", "adafactor"):
        optimizer = made(name)(decay_groups(net))
        losses = steps(net, optimizer, 60)
        sizes[name] = sum(s.numel() for state in optimizer.state.values() for s in state.values())
    assert losses[-1] < losses[0] / 3
    weights = sum(p.numel() for p in net.parameters())
    assert sizes["adamw"] > 2 * weights and sizes["adafactor"] < 0.05 * weights


def test_a_run_of_adamw_is_not_gone_on_with():
    net = network()
    saved = {"optimizer_states": [made("adamw")(decay_groups(net)).state_dict()]}
    parts = loss(), ImageMetrics(lpips=None), made("adafactor"), lambda _: None, checkpoint_info()
    with pytest.raises(UserError, match="another optimizer"):
        RenderingModule(net, *parts).on_load_checkpoint(saved)

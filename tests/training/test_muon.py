"""Muon beside AdamW: who gets which parameter, one schedule for both, and a state that can be gone on with."""

from copy import deepcopy

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from network_variants import loss
from networks import checkpoint_info, network
from torch import nn
from torch.optim import Muon

from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.metrics.image import ImageMetrics
from rfpp.model.layers.block import SwiGLU
from rfpp.training.module import RenderingModule, decay_groups
from rfpp.training.muon import MuonWithAdamW
from rfpp.training.schedule import warmup_cosine


class Small(nn.Module):
    """Two layers whose middle is hidden."""

    def __init__(self):
        super().__init__()
        self.into, self.hidden, self.out = nn.Linear(4, 6), SwiGLU(6, 8), nn.Linear(6, 1)

    def forward(self, x):
        return self.out(self.hidden(self.into(x)))


@pytest.fixture(scope="module")
def make():
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("train", overrides=["run_dir=unused", "optimizer=muon", "optimizer.lr=0.02"])
    return instantiate(cfg.optimizer, _convert_="all")


def steps(net, optimizer, count, schedule=None):
    x = torch.randn(64, 4, generator=torch.Generator().manual_seed(0))
    losses = []
    for _ in range(count):
        loss = (net(x)[:, 0] - x.prod(1)).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if schedule:
            schedule.step()
        losses.append(float(loss.detach()))
    return losses


def small() -> Small:
    torch.manual_seed(0)
    return Small()


def test_hidden_matrices_go_to_muon_and_all_else_to_adamw(make):
    net = network()
    optimizer = make(decay_groups(net))
    muon, adam = optimizer._parts
    assert isinstance(muon, Muon)
    hidden = {id(p) for group in muon.param_groups for p in group["params"]}
    others = {id(p) for group in adam.param_groups for p in group["params"]}
    assert hidden | others == {id(p) for p in net.parameters()} and not hidden & others
    names = {name for name, p in net.named_parameters() if id(p) in hidden}
    assert "tokenizer.encoder.0.attention.in_proj.weight" in names
    assert not any(
        part in name for name in names for part in ("embedding", "rays", "head", "norm", "tokenizer.queries")
    )
    decays = [group["weight_decay"] for group in adam.param_groups for p in group["params"] if p.ndim < 2]
    assert set(decays) == {0.0}


def test_the_loss_falls_and_everything_moves(make):
    net = small()
    before = {name: p.clone() for name, p in net.named_parameters()}
    losses = steps(net, make(decay_groups(net)), 60)
    assert losses[-1] < 0.5 * losses[0]
    assert all(not torch.equal(before[name], p) for name, p in net.named_parameters())


def test_a_matrix_steps_along_the_orthogonalised_gradient(make):
    net = small()
    before = net.hidden.in_proj.weight.detach().clone()
    steps(net, make(decay_groups(net)), 1)
    moved = net.hidden.in_proj.weight.detach() - before
    values = [torch.linalg.svdvals(matrix) for matrix in (moved, net.hidden.in_proj.weight.grad)]
    spread = [float(v[0] / v[-1]) for v in values]
    assert spread[0] < 0.3 * spread[1], "directions move more alike than gradients ask for"


def test_one_schedule_serves_both(make):
    net = small()
    optimizer = make(decay_groups(net))
    schedule = warmup_cosine(optimizer, warmup_steps=4, total_steps=8, final_fraction=0.0)
    assert {group["lr"] for group in optimizer.param_groups} == {0.02 / 4}
    steps(net, optimizer, 8, schedule)
    assert {group["lr"] for part in optimizer._parts for group in part.param_groups} == {0.0}
    before = {name: p.clone() for name, p in net.named_parameters()}
    steps(net, optimizer, 1)
    assert all(torch.equal(before[name], p) for name, p in net.named_parameters()), "nothing moves at rate zero"


def test_what_goes_on_from_its_state_takes_the_same_steps(make):
    whole = small()
    optimizer = make(decay_groups(whole))
    steps(whole, optimizer, 3)
    resumed, state = small(), deepcopy(optimizer.state_dict())
    resumed.load_state_dict(whole.state_dict())
    again = make(decay_groups(resumed))
    again.load_state_dict(state)
    steps(whole, optimizer, 3)
    steps(resumed, again, 3)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        assert torch.equal(a, b)


def test_quickstart_chooses_its_rate():
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("train", overrides=["run_dir=unused", "experiment=quickstart", "optimizer=muon"])
    optimizer = instantiate(cfg.optimizer)(decay_groups(small()))
    assert isinstance(optimizer, MuonWithAdamW)
    assert {group["lr"] for group in optimizer.param_groups} == {1e-3}


@pytest.mark.parametrize(("before", "now"), [("adamw", "muon"), ("muon", "adamw")])
def test_a_run_of_another_optimizer_is_not_gone_on_with(before, now):
    made = {}
    for name in (before, now):
        with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
            cfg = compose("train", overrides=["run_dir=unused", f"optimizer={name}", "optimizer.fused=false"])
        made[name] = instantiate(cfg.optimizer)
    net = network()
    modules = {
        name: RenderingModule(net, loss(), ImageMetrics(lpips=None), optimizer, lambda _: None, checkpoint_info())
        for name, optimizer in made.items()
    }
    saved = {"optimizer_states": [made[before](decay_groups(net)).state_dict()]}
    modules[before].on_load_checkpoint(saved)
    with pytest.raises(UserError, match="another optimizer"):
        modules[now].on_load_checkpoint(saved)

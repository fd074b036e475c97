"""Checkpoints: what is read back, and everything that is refused in one line."""

import os
from copy import deepcopy

import pytest
import torch
from networks import checkpoint_info, model_config, network

from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX, load_network
from rfpp.checkpoint.network_building import build
from rfpp.errors import CheckpointError


def save(path, net=None, model=None, **changes):
    info = {**checkpoint_info(model).to_dict(), **changes}
    state = {NETWORK_PREFIX + k: v for k, v in (net or network()).state_dict().items()}
    torch.save({CHECKPOINT_KEY: info, "state_dict": state}, path)
    return path


def refusal(path) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_network(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_a_network_comes_back_as_it_was(tmp_path):
    saved = network(seed=5)
    loaded, info = load_network(save(tmp_path / "a.ckpt", saved))
    assert not loaded.training
    assert info.resolution == (16, 16)
    for (name, a), b in zip(saved.state_dict().items(), loaded.state_dict().values(), strict=True):
        assert torch.equal(a, b), name


def test_a_truncated_file(tmp_path):
    path = save(tmp_path / "a.ckpt")
    path.write_bytes(path.read_bytes()[:5000])
    assert "cannot be read" in refusal(path)


def test_somebody_elses_checkpoint(tmp_path):
    torch.save({"state_dict": {}}, tmp_path / "other.ckpt")
    assert "not a checkpoint of this project" in refusal(tmp_path / "other.ckpt")


def test_weights_of_another_model(tmp_path):
    wider = network("size.hidden=32")
    assert "has another shape for" in refusal(save(tmp_path / "wide.ckpt", wider))
    deeper = network("size.encoder_layers=2")
    assert "unknown tensor tokenizer.encoder.1" in refusal(save(tmp_path / "deep.ckpt", deeper))
    shallow = save(tmp_path / "shallow.ckpt", model=model_config("size.encoder_layers=2"))
    assert "lacks tokenizer.encoder.1" in refusal(shallow)


def test_another_schema_version(tmp_path):
    assert "schema 99" in refusal(save(tmp_path / "a.ckpt", schema_version=99))


class Evil:
    def __reduce__(self):
        return os.system, ("touch pwned",)


def test_loading_executes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({CHECKPOINT_KEY: Evil(), "state_dict": {}}, "evil.ckpt")
    assert "names code" in refusal(tmp_path / "evil.ckpt")
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize("target", ["os.system", "subprocess.run", "rfpp.commands.write_config", 7])
def test_a_config_may_only_name_parts_of_the_model(target):
    with pytest.raises(CheckpointError, match="refused"):
        build({"_target_": target, "command": "true"}, "evil.ckpt")


@pytest.mark.parametrize(
    "target", ["rfpp.model.dpt.nn.Linear", "rfpp.model.layers.block.F", "rfpp.model.layers.attention.attend"]
)
def test_a_config_may_not_reach_through_a_module(target):
    with pytest.raises(CheckpointError, match="cannot build"):
        build({"_target_": target}, "evil.ckpt")


def changed(path: tuple, value) -> dict:
    """The configuration of the tests' network with one value changed."""
    config = deepcopy(model_config())
    part = config
    for name in path[:-1]:
        part = part[name]
    part[path[-1]] = value
    return config


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("decoder", "layers"), 5000, "layers=5000 is more than 1024"),
        (("transport", "iterations"), 10**9, "holds a number"),
        (("decoder", "width"), 10**400, "holds a number"),
        (("decoder", "width"), float("nan"), "holds a number"),
        (("decoder", "width"), 1 << 20, "it belongs to another model"),
        (("decoder", "heads"), 0, "cannot build rfpp.model.view_decoder.ViewDecoder"),
        (("decoder", "width"), "wide", "cannot build"),
        (("_target_",), "rfpp.model.dpt.DPTHead", "cannot build rfpp.model.dpt.DPTHead"),
        (("anything",), 1, "cannot build rfpp.model.renderformer_pp.RenderFormerPP"),
    ],
)
def test_a_configuration_that_no_network_has_is_refused_at_once(tmp_path, path, value, message):
    assert message in refusal(save(tmp_path / "a.ckpt", model=changed(path, value)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": {"_target_": "rfpp.model.exposure.UnitExposure"}}, "describes no network"),
        ({"model": [1, 2]}, "model: Input should be a valid dictionary"),
        ({"resolution": [0, 16]}, "claims training at (0, 16) pixels"),
        ({"resolution": 16}, "resolution: "),
        ({"seed": "first"}, "seed: "),
        ({"surprise": 1}, "surprise: "),
    ],
)
def test_a_description_that_does_not_fit_is_refused(tmp_path, changes, message):
    content = torch.load(save(tmp_path / "a.ckpt"), weights_only=True)
    content[CHECKPOINT_KEY] |= changes
    torch.save(content, tmp_path / "a.ckpt")
    assert message in refusal(tmp_path / "a.ckpt")


@pytest.mark.filterwarnings("ignore")  # of PyTorch, about kinds of tensors
@pytest.mark.parametrize("kind", ["sparse", "meta", "quantized", "nested"])
def test_weights_that_are_not_plain_are_refused(tmp_path, kind):
    tensor = {
        "sparse": lambda: torch.eye(3).to_sparse(),
        "meta": lambda: torch.empty(3, device="meta"),
        "quantized": lambda: torch.quantize_per_tensor(torch.ones(3), 0.1, 0, torch.quint8),
        "nested": lambda: torch.nested.nested_tensor([torch.ones(2), torch.ones(3)]),
    }[kind]()
    content = {CHECKPOINT_KEY: checkpoint_info().to_dict(), "state_dict": {"network.weight": tensor}}
    torch.save(content, tmp_path / "a.ckpt")
    with pytest.raises(CheckpointError, match=r"a\.ckpt: (its weights are no plain tensors|cannot be read)"):
        load_network(tmp_path / "a.ckpt")


def test_a_list_of_millions_is_refused_before_it_is_made(tmp_path):
    torch.save(
        {CHECKPOINT_KEY: checkpoint_info().to_dict(), "state_dict": {}, "list": [[]] * 5_000_000}, tmp_path / "a"
    )
    with pytest.raises(CheckpointError, match="bytes describe its tensors, the limit is 4,194,304"):
        load_network(tmp_path / "a")


@pytest.mark.parametrize("state", [None, 7, [1], {"network.a": 3}])
def test_weights_that_are_none_are_refused(tmp_path, state):
    torch.save({CHECKPOINT_KEY: checkpoint_info().to_dict(), "state_dict": state}, tmp_path / "a.ckpt")
    assert "holds no weights" in refusal(tmp_path / "a.ckpt")

"""Networks as folders: what is saved renders the same, and what is damaged says so."""

import json
import os

import numpy as np
import pytest
import torch
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.checkpoint.loading import load_network
from rfpp.errors import CheckpointError
from rfpp.inference.renderer import Renderer

METRICS = {"test": {"log_l1": 0.0123456, "psnr": 27.25}, "validation": {"log_l1": 0.01}}


@pytest.fixture(scope="module")
def renderer():
    return Renderer(network(), checkpoint_info(steps=540, dataset="toys", data_manifest="0123456789abcdef"))


@pytest.fixture
def folder(renderer, tmp_path):
    return renderer.save(tmp_path / "toy", METRICS)


def test_a_saved_network_renders_the_same_image(renderer, folder):
    again = Renderer.load(folder, "cpu", "fp32")
    assert again.info == renderer.info
    np.testing.assert_array_equal(again.render(scene()), renderer.render(scene()))


def test_a_store_that_others_do_not_have_is_not_passed_on(tmp_path):
    info = checkpoint_info(mlflow_run_id="f00d", mlflow_tracking_uri="sqlite:////home/me/mlflow.db")
    folder = Renderer(network(), info).save(tmp_path / "toy")
    assert not any(b"home/me" in path.read_bytes() for path in folder.iterdir())
    assert Renderer.load(folder).info.mlflow_run_id is None


def test_the_card_says_what_it_is(folder):
    card = (folder / "README.md").read_text()
    for stated in (
        "540",
        "toys",
        "0123456789ab",
        'Renderer.load("toy")',
        "| test | 0.01235 | 27.25 |",
        "library_name: rfpp",
    ):
        assert stated in card
    assert "| validation | 0.01 |  |" in card


def test_saving_over_another_network_replaces_it(folder):
    other = Renderer(network(seed=1), checkpoint_info())
    other.save(folder)
    np.testing.assert_array_equal(Renderer.load(folder, "cpu", "fp32").render(scene()), other.render(scene()))
    assert "not evaluated" in (folder / "README.md").read_text()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / "config.json").unlink(), "config.json"),
        (lambda f: (f / "config.json").write_text("[" * 100_000), "config.json"),
        (lambda f: (f / "model.safetensors").unlink(), "model.safetensors"),
        (lambda f: (f / "model.safetensors").write_bytes((f / "model.safetensors").read_bytes()[:-9]), "copy it again"),
        (lambda f: _edit(f, schema_version=99), "use the version"),
        (lambda f: _edit(f, surprise=1), "does not fit"),
        (lambda f: _edit(f, model={"_target_": "os.system", "command": "true"}), "refused"),
        (lambda f: _edit(f, model={"_target_": "rfpp.model.hoct.Nothing"}), "Nothing"),
    ],
)  # fmt: skip
def test_damage_is_one_line_that_names_it(damage, message, folder):
    damage(folder)
    with pytest.raises(CheckpointError, match=message) as error:
        Renderer.load(folder)
    assert str(folder) in str(error.value) and "\n" not in str(error.value)


def _edit(folder, **changes):
    path = folder / "config.json"
    content = json.loads(path.read_text())
    content["rfpp"] |= changes
    path.write_text(json.dumps(content))


def test_training_starts_from_a_folder(folder, renderer):
    from rfpp.checkpoint.loading import load_initial_weights

    fresh = network(seed=5)
    load_initial_weights(fresh, folder)
    for name, weight in fresh.state_dict().items():
        assert torch.equal(weight, renderer.engine.module.state_dict()[name]), name


def test_a_pipe_is_not_read(folder, tmp_path):
    (tmp_path / "model.safetensors").write_bytes((folder / "model.safetensors").read_bytes())
    os.mkfifo(tmp_path / "config.json")
    with pytest.raises(CheckpointError, match=r"config\.json: is not a plain file"):
        load_network(tmp_path)

"""Networks that come with the project are found by their names, and nothing else is."""

import numpy as np
import pytest
from edited_scenes import scene
from networks import checkpoint_info, network

from rfpp.checkpoint import shipped
from rfpp.errors import CheckpointError
from rfpp.inference.renderer import Renderer


@pytest.fixture
def ours(tmp_path, monkeypatch):
    """The folder of a network called "toy"."""
    monkeypatch.setattr(shipped, "FOLDER", tmp_path / "models")
    return Renderer(network(), checkpoint_info()).save(tmp_path / "models" / "toy")


def test_a_network_is_loaded_by_its_name(ours):
    by_name, by_path = Renderer.load("toy", "cpu", "fp32"), Renderer.load(ours, "cpu", "fp32")
    np.testing.assert_array_equal(by_name.render(scene()), by_path.render(scene()))


def test_a_folder_of_that_name_here_comes_first(ours, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = Renderer(network(seed=1), checkpoint_info())
    other.save("toy")
    np.testing.assert_array_equal(Renderer.load("toy", "cpu", "fp32").render(scene()), other.render(scene()))


@pytest.mark.parametrize("name", ["", ".", "..", "../models/toy", "models/toy", "toys"])
def test_other_names_are_none_of_ours(ours, name):
    assert shipped.shipped(name) is None


def test_an_unknown_name_is_refused(ours):
    with pytest.raises(CheckpointError, match="toys: no such checkpoint"):
        Renderer.load("toys")

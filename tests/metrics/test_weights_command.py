"""Fetching the weights of LPIPS. `make install` does it from the network, and the published values are checked then."""

import re

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file

from launch.weights import main
from rfpp.metrics.lpips import TRUNK, load_trunk, trunk_file


@pytest.fixture
def published(tmp_path, monkeypatch) -> dict[str, torch.Tensor]:
    """The published weights, when neither a cache nor a network is there any more."""
    trunk = load_trunk()

    def unreachable(*_, **__):
        raise OSError("unreachable")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", unreachable)
    return trunk


def fetch(file=None):
    return main.__wrapped__(OmegaConf.create({"file": file and str(file)}))


@pytest.fixture
def refused(published, capsys):
    """`refused(file)`: the error of the command, in one line."""

    def run(file=None) -> str:
        with pytest.raises(SystemExit):
            fetch(file)
        assert not trunk_file().exists()
        return capsys.readouterr().err.partition("error: ")[2]

    return run


@pytest.mark.parametrize("suffix", ["pth", "safetensors"])
def test_a_file_is_cached_without_what_lpips_does_not_read(published, tmp_path, suffix) -> None:
    file, content = tmp_path / f"vgg.{suffix}", published | {"classifier.0.weight": torch.zeros(1)}
    save_file(content, file) if suffix == "safetensors" else torch.save(content, file)
    assert fetch(file) == trunk_file()
    cached = load_trunk()
    assert cached.keys() == published.keys()
    assert all(torch.equal(cached[name], value) for name, value in published.items())


def test_torch_hub_is_asked_once(published, monkeypatch) -> None:
    calls = []
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", lambda *_, **__: calls.append(1) or published)
    assert fetch() == fetch() == trunk_file()
    assert calls == [1]


def test_without_a_network_one_line_says_what_to_copy(refused) -> None:
    assert re.fullmatch(r".*copy https://\S+\.pth to this machine, then add file=<copy>\n", refused())


@pytest.mark.parametrize("content", [b"", b"not weights", None])
def test_an_unreadable_file_is_named(refused, tmp_path, content) -> None:
    if content is not None:
        (tmp_path / "mine.pth").write_bytes(content)
    assert re.fullmatch(r"file=.*mine\.pth: cannot be read \(.*\)\n", refused(tmp_path / "mine.pth"))


@pytest.mark.parametrize("content", ["other values", "fewer layers", "no weights"])
def test_another_network_is_refused(refused, random_trunk, tmp_path, content) -> None:
    others = {"other values": random_trunk, "fewer layers": {TRUNK[0]: random_trunk[TRUNK[0]]}, "no weights": [1]}
    torch.save(others[content], tmp_path / "other.pth")
    assert re.fullmatch(r".*other\.pth: not the weights of https://\S+\n", refused(tmp_path / "other.pth"))

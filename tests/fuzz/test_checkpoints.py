import io
import json
from pathlib import Path

import pytest
import torch
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import JSON_VALUES, altered, damaged, dumped
from networks import checkpoint_info, network
from safetensors.torch import save
from torch import nn

from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX, load_network
from rfpp.errors import CheckpointError

pytestmark = pytest.mark.timeout(36_000)  # of thousands

NETWORK = network()
WEIGHTS = {name: tensor.clone() for name, tensor in NETWORK.state_dict().items()}
INFO = json.loads(json.dumps(checkpoint_info().to_dict()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("network")
    (folder / "model.safetensors").write_bytes(save(WEIGHTS))
    (folder / "config.json").write_text(json.dumps({CHECKPOINT_KEY: INFO}))
    return folder


def load(path: Path, named: Path) -> None:
    """Passes if it is a network that draws, or is refused in one line with the name of `named`."""
    with attempt("checkpoints") as one:
        loaded, refusal = _loaded(path)
        if loaded is None:
            assert str(named) in refusal
            assert "\n" not in refusal
            return
        assert loaded.state_dict().keys() == WEIGHTS.keys()
        one.taken = True


def _loaded(path: Path) -> tuple[nn.Module | None, str]:
    try:
        return load_network(path)[0], ""
    except CheckpointError as error:
        return None, str(error)


DESCRIPTIONS = altered(INFO) | altered(INFO["model"]).map(lambda model: {**INFO, "model": model}) | JSON_VALUES


@fuzzed
@given(DESCRIPTIONS.map(lambda info: dumped({CHECKPOINT_KEY: info})) | damaged(dumped({CHECKPOINT_KEY: INFO})))
def test_altered_and_damaged_descriptions(folder: Path, content: bytes) -> None:
    (folder / "config.json").write_bytes(content)
    load(folder, folder)


@fuzzed
@given(damaged(save(WEIGHTS)))
def test_damaged_weights(tmp_path_factory, content: bytes) -> None:
    folder = tmp_path_factory.getbasetemp() / "damaged_weights"
    folder.mkdir(exist_ok=True)
    (folder / "model.safetensors").write_bytes(content)
    (folder / "config.json").write_text(json.dumps({CHECKPOINT_KEY: INFO}))
    load(folder, folder)


def lightning(info: object, weights: dict[str, torch.Tensor]) -> bytes:
    """Return a checkpoint in the format of launch/train.py."""
    file = io.BytesIO()
    torch.save({CHECKPOINT_KEY: info, "state_dict": {NETWORK_PREFIX + k: v for k, v in weights.items()}}, file)
    return file.getvalue()


@fuzzed
@given(damaged(lightning(INFO, WEIGHTS)) | altered(INFO).map(lambda info: lightning(info, WEIGHTS)))
def test_damaged_and_altered_files_of_training(folder: Path, content: bytes) -> None:
    path = folder / "best.ckpt"
    path.write_bytes(content)
    load(path, path)


@fuzzed
@given(st.sampled_from(sorted(WEIGHTS)), st.sampled_from(["longer", "shorter", "gone", "another", "integers"]))
def test_weights_of_another_network(folder: Path, name: str, change: str) -> None:
    one = WEIGHTS[name]
    changes = {
        "longer": {name: torch.cat([one, one])}, "shorter": {name: one[:0]}, "gone": {}, "integers": {name: one.int()},
        "another": {"other": one},
    }  # fmt: skip
    rest = {key: value for key, value in WEIGHTS.items() if key != name}
    path = folder / "other.ckpt"
    path.write_bytes(lightning(INFO, rest | changes[change]))
    load(path, path)

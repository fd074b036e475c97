"""Load a network from a checkpoint without executing code from it."""

from __future__ import annotations

import pickle
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import ConfigDict, TypeAdapter, ValidationError
from torch import nn

from rfpp.checkpoint.model_folder import CONFIG_FILE, folder_of, names_folder, read_folder
from rfpp.checkpoint.network_building import build_network, require_fitting
from rfpp.checkpoint.released_weights import released, with_folded_texture
from rfpp.errors import CheckpointError, one_line
from rfpp.model.triangle_embedding import TriangleEmbedding

#: Where a Lightning checkpoint keeps a `CheckpointInfo`.
CHECKPOINT_KEY = "rfpp"
SCHEMA_VERSION = 3
#: The network's place in a Lightning state dict.
NETWORK_PREFIX = "network."
_LARGEST_SIDE = 1 << 14
#: Bytes of a checkpoint beside its tensors; training `tiny` needs a 45th of them.
_MAX_DESCRIPTION = 1 << 22
#: What is known of the released RenderFormer; 512 pixels are its pipeline's default.
RELEASED = {
    "resolution": (512, 512),
    "data_manifest": "unknown",
    "dataset": "its authors' data",
    "method": "RenderFormer",
    "seed": 0,
    "steps": None,
}


@dataclass(frozen=True)
class CheckpointInfo:
    """Description of a checkpoint.

    Attributes:
        model: nested `_target_` config of the network, all values plain.
        resolution: (height, width) the network was trained at.
        data_manifest: hash of the data set's manifest.
        method: the network's name in tables of results, e.g. "RenderFormer++".
        commit: code version, or None outside a repository.
        mlflow_run_id, mlflow_tracking_uri: the run it belongs to, or None.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    model: dict[str, Any]
    resolution: tuple[int, int]
    data_manifest: str
    dataset: str
    method: str
    seed: int
    steps: int | None
    commit: str | None = None
    mlflow_run_id: str | None = None
    mlflow_tracking_uri: str | None = None
    schema_version: int = SCHEMA_VERSION

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def load_network(path: Path | str) -> tuple[nn.Module, CheckpointInfo]:
    """Load a network in evaluation mode on the CPU, and the description in its checkpoint.

    Args:
        path: File of launch/train.py; or folder with config.json and model.safetensors, of `Renderer.save` or a
            released RenderFormer, or its id on the Hugging Face hub.

    Raises:
        CheckpointError: If it is missing, unreadable or of an unknown kind, or if its weights do not fit its network.
    """
    info, weights = _read(path)
    network = build_network(info.model, weights, str(path))
    network.load_state_dict(weights)
    return network.eval(), info


def load_initial_weights(network: nn.Module, path: Path | str) -> None:
    """Initialize a network with the weights of a checkpoint, ours or a released RenderFormer.

    A released texture encoder is folded for a network with one material per triangle.

    Raises:
        CheckpointError: If the checkpoint cannot be read or belongs to another model.
    """
    _, weights = _read(path)
    if isinstance(network.embedding, TriangleEmbedding) and "embedding.texture_proj.weight" in weights:
        weights = with_folded_texture(weights)
    require_fitting(network, weights, str(path))
    network.load_state_dict(weights)


def _read(checkpoint: Path | str) -> tuple[CheckpointInfo, dict[str, torch.Tensor]]:
    """Return the description of a checkpoint and its network's weights."""
    if not names_folder(checkpoint):
        return _read_file(Path(checkpoint))
    folder = folder_of(checkpoint)
    config, tensors = read_folder(folder)
    if CHECKPOINT_KEY in config:
        return _info(config[CHECKPOINT_KEY], folder / CONFIG_FILE), tensors
    model, weights = released(config, tensors, folder)
    return CheckpointInfo(model, **RELEASED), weights


def _read_file(path: Path) -> tuple[CheckpointInfo, dict[str, torch.Tensor]]:
    if path.parts[0] == "models:":
        raise CheckpointError(
            f"{path}: is a model of MLflow's registry: use it with launch/render.py or launch/evaluate.py, or fetch "
            "its file with rfpp.training.tracking.registry.checkpoint_file"
        )
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint: train one with launch/train.py, or correct the path")
    content = read_checkpoint(path)
    state = content.get("state_dict")
    if not isinstance(state, dict) or not all(isinstance(x, torch.Tensor) for x in state.values()):
        raise CheckpointError(f"{path}: holds no weights: give a checkpoint written by launch/train.py")
    if not all(map(_is_plain, state.values())):
        raise CheckpointError(f"{path}: its weights are no plain tensors: give a checkpoint written by launch/train.py")
    weights = {k.removeprefix(NETWORK_PREFIX): v for k, v in state.items() if str(k).startswith(NETWORK_PREFIX)}
    return _info(content[CHECKPOINT_KEY], path), weights


def _is_plain(tensor: torch.Tensor) -> bool:
    is_dense = tensor.layout == torch.strided and not (tensor.is_nested or tensor.is_quantized)
    return is_dense and tensor.device.type == "cpu"


def read_checkpoint(path: Path, **how: Any) -> dict[str, Any]:
    """Read a checkpoint written by Lightning, without executing code from it.

    Args:
        path: File.
        how: Further arguments of torch.load.

    Raises:
        CheckpointError: If it cannot be read, holds more than tensors and plain values, or is not of this project.
    """
    _require_small_description(path)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True, **how)
    except Exception as error:  # a stranger's file: pickle, zip and tensors fail in many ways
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:160]
        if isinstance(error, pickle.UnpicklingError) and "GLOBAL" in str(error):
            raise CheckpointError(f"{path}: names code, not only tensors and plain values: refused") from None
        raise CheckpointError(f"{path}: cannot be read as a checkpoint ({reason}): copy it again") from None
    if not isinstance(content, dict) or CHECKPOINT_KEY not in content:
        raise CheckpointError(f"{path}: not a checkpoint of this project: give one written by launch/train.py")
    return content


def _require_small_description(path: Path) -> None:
    """Raise CheckpointError if the part of a file that becomes Python objects, all but its tensors, is too large."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist() if entry.filename.endswith(".pkl"))
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError) as error:
        raise CheckpointError(
            f"{path}: cannot be read as a checkpoint ({one_line(str(error))}): copy it again"
        ) from None
    if size > _MAX_DESCRIPTION:
        raise CheckpointError(
            f"{path}: {size:,} bytes describe its tensors, the limit is {_MAX_DESCRIPTION:,}: give a checkpoint "
            "written by launch/train.py"
        )


def _info(about: Any, path: Path) -> CheckpointInfo:
    version = about.get("schema_version") if isinstance(about, dict) else None
    if version != SCHEMA_VERSION:
        raise CheckpointError(
            f"{path}: checkpoint schema {version}, this code reads {SCHEMA_VERSION}: "
            "use the version of rfpp that made it"
        )
    try:
        info = TypeAdapter(CheckpointInfo).validate_python(about)  # JSON has lists only, which become tuples
    except ValidationError as error:
        first = error.errors()[0]
        what = ".".join(map(str, first["loc"]))
        raise CheckpointError(
            f"{path}: its description does not fit ({what}: {first['msg']}): use the version of rfpp that wrote it"
        ) from None
    if not all(0 < side <= _LARGEST_SIDE for side in info.resolution):
        raise CheckpointError(
            f"{path}: claims training at {info.resolution} pixels: use the version of rfpp that wrote it"
        )
    return info

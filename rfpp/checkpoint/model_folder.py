"""Model folders: config.json and model.safetensors, ours or RenderFormer's, on disk or on the Hugging Face hub."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from rfpp.checkpoint.shipped import shipped
from rfpp.errors import CheckpointError, MissingDependencyError
from rfpp.files import write_atomically

CONFIG_FILE, WEIGHTS_FILE, CARD_FILE = "config.json", "model.safetensors", "README.md"

_HUB_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*")


def names_folder(checkpoint: Path | str) -> bool:
    """Return whether this names a model folder: an existing one, a shipped one, or a hub id."""
    path = Path(checkpoint)
    is_hub_id = _HUB_ID.fullmatch(str(checkpoint)) and path.suffix != ".ckpt"
    return path.is_dir() or (not path.exists() and bool(shipped(str(checkpoint)) or is_hub_id))


def folder_of(checkpoint: Path | str) -> Path:
    """Return the path of a model folder: an existing one, a shipped one, or a download from the hub.

    Raises:
        CheckpointError: If it cannot be downloaded.
        MissingDependencyError: If it is a hub id and huggingface_hub is not installed.
    """
    if Path(checkpoint).is_dir():
        return Path(checkpoint)
    return shipped(str(checkpoint)) or _downloaded(str(checkpoint))


def read_folder(folder: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read configuration and weights. Raises CheckpointError naming a missing or damaged file."""
    config, weights = folder / CONFIG_FILE, folder / WEIGHTS_FILE
    for file in (config, weights):
        if file.exists() and not file.is_file():
            raise CheckpointError(f"{file}: is not a plain file: copy it again")
    try:
        content = json.loads(config.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{config}: cannot be read ({error}): copy it again") from None
    if not isinstance(content, dict):
        raise CheckpointError(f"{config}: is not a JSON object: copy it again")
    try:
        return content, load_file(weights)
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{weights}: cannot be read ({error}): copy it again") from None


def write_folder(folder: Path, config: Mapping[str, Any], weights: Mapping[str, Tensor], card: str) -> Path:
    """Write a model folder with its card, and return it. Raises UserError if it cannot be written."""
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in weights.items()}
    write_atomically(folder / WEIGHTS_FILE, save(contiguous))
    write_atomically(folder / CARD_FILE, card.encode())
    write_atomically(folder / CONFIG_FILE, (json.dumps(config, indent=2) + "\n").encode())
    return folder


def _downloaded(name: str) -> Path:
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        raise MissingDependencyError(
            f"{name}: no such file or folder, and to fetch it from the hub huggingface_hub is missing: "
            "pip install 'rfpp[hub]'"
        ) from error
    try:
        return Path(snapshot_download(name, allow_patterns=[CONFIG_FILE, WEIGHTS_FILE]))
    except Exception as error:  # the hub's errors share no base class
        reason = str(error).strip().splitlines()[0][:160] if str(error).strip() else type(error).__name__
        raise CheckpointError(f"{name}: no such file, and the hub does not have it ({reason})") from None

"""Save a command's resolved configuration beside its output."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from rfpp.files import write_atomically


def write_config(cfg: Mapping[str, Any], folder: Path, name: str = "config.yaml") -> Path:
    """Write a configuration with all values resolved, atomically; return its path."""
    return write_atomically(folder / name, OmegaConf.to_yaml(cfg, resolve=True).encode())

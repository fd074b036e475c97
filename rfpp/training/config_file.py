"""Save a command's resolved configuration beside its output."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from rfpp.files import write_atomically


def write_config(cfg: DictConfig, folder: Path, name: str = "config.yaml") -> Path:
    """Write the config with every value resolved into `folder`, atomically; returns the file's path."""
    return write_atomically(folder / name, OmegaConf.to_yaml(cfg, resolve=True).encode())

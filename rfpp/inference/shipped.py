"""Trained networks that come with the project, by their names."""

from __future__ import annotations

import sysconfig
from pathlib import Path

#: Of the source tree, and of an installed package: pyproject.toml's data-files.
_FOLDERS = (
    Path(__file__).parents[2] / "data" / "models",
    Path(sysconfig.get_path("data")) / "share" / "rfpp" / "models",
)


def shipped(name: str) -> Path | None:
    """The folder of the network of this name, if it is one of ours."""
    folders = (path for parent in _FOLDERS if parent.is_dir() for path in parent.iterdir() if path.is_dir())
    return next((path for path in folders if path.name == name), None)

"""Trained networks that come with the project, by their names."""

from __future__ import annotations

import sysconfig
from pathlib import Path

#: In the source tree, and where pip puts them (pyproject.toml, `data-files`).
_FOLDERS = (
    Path(__file__).parents[2] / "data" / "models",
    Path(sysconfig.get_path("data")) / "share" / "rfpp" / "models",
)


def shipped(name: str) -> Path | None:
    """The folder of the network of this name, if it is one of ours."""
    known = (path for folder in _FOLDERS if folder.is_dir() for path in folder.iterdir() if path.is_dir())
    return next((path for path in known if path.name == name), None)

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
    if not name or Path(name).name != name:
        return None
    return next((folder / name for folder in _FOLDERS if (folder / name).is_dir()), None)

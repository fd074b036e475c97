"""Folders of the project's top level, which travel inside of the package when it is installed."""

from __future__ import annotations

from pathlib import Path


def carried(folder: str, inside: str) -> Path:
    """A folder of the source tree, or where an installed package has it.

    Args:
        folder: relative to the source tree's top level, as "conf".
        inside: its name within the package, see `package-dir` in pyproject.toml.
    """
    package = Path(__file__).resolve().parent
    installed = package / inside
    return installed if installed.is_dir() else package.parent / folder

"""Top-level folders, which are part of the package when it is installed."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def is_installed() -> bool:
    """Return whether the package is installed, not run from the source tree."""
    return (_PACKAGE / "_conf").is_dir()


def carried(folder: str, inside: str) -> Path:
    """Return a folder of the source tree, or its copy in the installed package.

    Args:
        folder: relative to the source tree's top level, as "conf".
        inside: its name within the package, see `package-dir` in pyproject.toml.
    """
    return _PACKAGE / inside if is_installed() else _PACKAGE.parent / folder

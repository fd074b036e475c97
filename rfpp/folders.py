"""Top-level folders, which are part of the package when it is installed."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def is_installed() -> bool:
    """Whether the package lies where an installer put it, and not in the project's source tree."""
    return (_PACKAGE / "_conf").is_dir()


def carried(folder: str, inside: str) -> Path:
    """A folder of the source tree, or where an installed package has it.

    Args:
        folder: relative to the source tree's top level, as "conf".
        inside: its name within the package, see `package-dir` in pyproject.toml.
    """
    return _PACKAGE / inside if is_installed() else _PACKAGE.parent / folder

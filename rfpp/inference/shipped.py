"""Trained networks that come with the project, by their names."""

from __future__ import annotations

from pathlib import Path

_MODELS = Path(__file__).parents[2] / "data" / "models"


def shipped(name: str) -> Path | None:
    """The folder of the network of this name, if it is one of ours."""
    folders = _MODELS.iterdir() if _MODELS.is_dir() else ()
    return next((path for path in folders if path.is_dir() and path.name == name), None)

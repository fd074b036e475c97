"""Trained networks shipped with the project, by name."""

from __future__ import annotations

from pathlib import Path

from rfpp.folders import carried

#: One folder for each.
FOLDER = carried("data/models", "_models")


def shipped(name: str) -> Path | None:
    """The folder of the network of this name, if it is one of ours."""
    known = (path for path in FOLDER.iterdir() if path.is_dir()) if FOLDER.is_dir() else ()
    return next((path for path in known if path.name == name), None)

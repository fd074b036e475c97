"""Trained networks shipped with the project, by name."""

from __future__ import annotations

from pathlib import Path

from rfpp.folders import carried

#: Folder with a folder for each network.
FOLDER = carried("data/models", "_models")


def shipped(name: str) -> Path | None:
    """Return the folder of the shipped network of this name, or None."""
    known = (path for path in FOLDER.iterdir() if path.is_dir()) if FOLDER.is_dir() else ()
    return next((path for path in known if path.name == name), None)

"""Modules of the add-on that do without Blender, for tests outside of it."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

_NAME = "rfpp_addon"


def addon(module: str) -> ModuleType:
    """One of them; the package itself, which imports Blender, is not imported."""
    if _NAME not in sys.modules:
        package = ModuleType(_NAME)
        package.__path__ = [str(Path(__file__).parents[2] / "rfpp" / "serve" / "addon")]
        sys.modules[_NAME] = package
    return importlib.import_module(f"{_NAME}.{module}")

"""rfpp as a render engine of Blender: sends scenes to `rfpp serve` on this machine and shows its pictures.

This package runs inside Blender and imports only Blender, NumPy and the standard library.
"""

from . import engine, settings_panels


def register() -> None:
    """Register all classes."""
    settings_panels.register()
    engine.register()


def unregister() -> None:
    """Unregister all classes."""
    engine.unregister()
    settings_panels.unregister()

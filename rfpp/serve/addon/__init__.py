"""rfpp as a render engine of Blender: scenes go to `rfpp serve` on this machine, pictures come back.

Everything is here that runs inside Blender; a program of its own that imports nothing but
Blender, NumPy and the standard library.
"""

from . import engine, settings_panels


def register() -> None:
    """Called by Blender."""
    settings_panels.register()
    engine.register()


def unregister() -> None:
    """Called by Blender."""
    engine.unregister()
    settings_panels.unregister()

"""rfpp: an open implementation of RenderFormer++.

from rfpp import Renderer, Scene
images = Renderer.load("best.ckpt").render(Scene.load("data/scenes/cornell_box.json"))
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpp.inference.renderer import Renderer
    from rfpp.scene.spec import Scene

__all__ = ["Renderer", "Scene"]

#: Where these are. Both take their time to import: only who asks for one should wait for it.
_MODULES = {"Renderer": "rfpp.inference.renderer", "Scene": "rfpp.scene.spec"}


def __getattr__(name: str):
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'rfpp' has no attribute {name!r}")

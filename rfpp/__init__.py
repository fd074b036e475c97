"""rfpp: an open implementation of RenderFormer++.

from rfpp import Renderer, load_scene
images = Renderer.load("best.ckpt").render(load_scene("data/scenes/cornell_box.json"))
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpp.inference.differentiable import DifferentiableRenderer
    from rfpp.inference.renderer import Renderer
    from rfpp.scene.io.loading import load_scene
    from rfpp.scene.io.saving import save_scene
    from rfpp.scene.spec import Scene

# Threads of GNU OpenMP, which PyTorch uses on Linux, wait for each other by spinning, for milliseconds. Beside another
# busy program that takes ten times as long as the work. The library reads this when PyTorch is
# loaded.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")
# So do threads of OpenBLAS, which NumPy uses, for 2^n cycles after each product: by default, as long as a view takes.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "16")

__all__ = ["DifferentiableRenderer", "Renderer", "Scene", "load_scene", "save_scene"]

#: Where these are. They take their time to import: only who asks for one should wait for it.
_MODULES = {
    "DifferentiableRenderer": "rfpp.inference.differentiable",
    "Renderer": "rfpp.inference.renderer",
    "Scene": "rfpp.scene.spec",
    "load_scene": "rfpp.scene.io.loading",
    "save_scene": "rfpp.scene.io.saving",
}


def __getattr__(name: str):
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'rfpp' has no attribute {name!r}")

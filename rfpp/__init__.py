"""rfpp: an open implementation of RenderFormer++.

from rfpp import Renderer
images = Renderer.load("best.ckpt").render("data/scenes/cornell_box.json")
"""

import os
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpp.inference.differentiable import DifferentiableRenderer
    from rfpp.inference.renderer import Renderer
    from rfpp.scene.io.loading import load_scene
    from rfpp.scene.io.saving import save_scene
    from rfpp.scene.mesh import Mesh
    from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform

# Threads of GNU OpenMP (PyTorch on Linux) and OpenBLAS (NumPy) spin while they wait for each other, which takes ten
# times as long beside another busy program. They read this when they are loaded.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "16")

#: Modules of the public names, imported when one is used.
_MODULES = {
    "DifferentiableRenderer": "rfpp.inference.differentiable",
    "Renderer": "rfpp.inference.renderer",
    "Mesh": "rfpp.scene.mesh",
    **dict.fromkeys(("Camera", "Material", "Scene", "SceneObject", "Transform"), "rfpp.scene.spec"),
    "load_scene": "rfpp.scene.io.loading",
    "save_scene": "rfpp.scene.io.saving",
}
__all__ = [
    "Camera", "DifferentiableRenderer", "Material", "Mesh", "Renderer", "Scene", "SceneObject", "Transform",
    "load_scene", "save_scene",
]  # fmt: skip


def __getattr__(name: str):
    if name == "__version__":
        return version("rfpp")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module 'rfpp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]

"""rfpp: an open implementation of RenderFormer++.

from rfpp import Renderer, Scene
images = Renderer.load("best.ckpt").render(Scene.load("data/scenes/cornell_box.json"))
"""

from rfpp.scene.spec import Scene

__all__ = ["Renderer", "Scene"]


def __getattr__(name: str):
    # torch takes a second to import: only who renders should wait for it
    if name == "Renderer":
        from rfpp.inference.renderer import Renderer

        return Renderer
    raise AttributeError(f"module 'rfpp' has no attribute {name!r}")

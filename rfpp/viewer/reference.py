"""Path-trace references in the background."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import UserError
from rfpp.inference.references import path_traced
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene


@dataclass(frozen=True, eq=False)
class Reference:
    """A path-traced image.

    Attributes:
        radiance: Linear radiance.
        seconds: Render time.
        scene: Scene of the image.
        camera: Camera of the image.
    """

    radiance: Float[np.ndarray, "h w 3"]
    seconds: float
    scene: Scene | PackedScene
    camera: Camera

    def shows(self, scene: Scene | PackedScene, camera: Camera, size: tuple[int, int]) -> bool:
        """Return whether it is an image of this view."""
        return self.scene is scene and self.camera == camera and self.radiance.shape[:2] == size


class PathTracer:
    """Path-traces one reference after another in a separate process.

    Args:
        settings: Settings of Cycles.
    """

    def __init__(self, settings: CyclesSettings):
        self.settings = settings
        self._executor = ThreadPoolExecutor(1, "path tracing")

    def start(
        self,
        scene: Scene | PackedScene,
        camera: Camera,
        size: tuple[int, int],
        done: Callable[[Reference], None],
        failed: Callable[[str], None],
    ) -> None:
        """Start a reference of (height, width); another thread calls `done`, or `failed` with one line."""

        def trace() -> None:
            try:
                [([radiance], seconds)] = path_traced([pack(scene).seen_by([camera])], size, self.settings)
                done(Reference(radiance, seconds, scene, camera))
            except UserError as error:
                failed(str(error))
            except Exception:  # the executor would discard it
                failed("path tracing failed: see the viewer's terminal")
                traceback.print_exc()

        self._executor.submit(trace)

    def close(self) -> None:
        """Discard references that have not started."""
        self._executor.shutdown(wait=False, cancel_futures=True)

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
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera, Scene


@dataclass(frozen=True, eq=False)
class Reference:
    """What Cycles made of a scene, and of which.

    Attributes:
        radiance: linear.
        seconds: that it took.
        scene, camera: that it shows.
    """

    radiance: Float[np.ndarray, "h w 3"]
    seconds: float
    scene: Scene | PackedScene
    camera: Camera

    def shows(self, scene: Scene | PackedScene, camera: Camera, size: tuple[int, int]) -> bool:
        """Whether it is of this very view."""
        return self.scene is scene and self.camera == camera and self.radiance.shape[:2] == size


class PathTracer:
    """One reference after another, in a process of its own.

    Args:
        settings: of Cycles.
    """

    def __init__(self, settings: CyclesSettings):
        self.settings = settings
        self._beside = ThreadPoolExecutor(1, "path tracing")

    def trace(
        self,
        packed: PackedScene,
        scene: Scene | PackedScene,
        camera: Camera,
        size: tuple[int, int],
        done: Callable[[Reference], None],
        failed: Callable[[str], None],
    ) -> None:
        """Begin one; `done` or, with one line, `failed` is called from another thread when it ends.

        Args:
            packed: `scene` seen by `camera` alone.
            size: (height, width).
        """

        def work() -> None:
            try:
                [([radiance], seconds)] = path_traced([packed], size, self.settings)
                done(Reference(radiance, seconds, scene, camera))
            except UserError as error:
                failed(str(error))
            except Exception:  # a defect: the executor would keep it to itself
                failed("path tracing broke down: the viewer's terminal says how")
                traceback.print_exc()

        self._beside.submit(work)

    def close(self) -> None:
        """Forget what has not begun."""
        self._beside.shutdown(wait=False, cancel_futures=True)

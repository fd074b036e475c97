"""Path-traced references of the viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.inference.references import path_traced
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Camera, Scene


@dataclass(frozen=True, eq=False)
class Reference:
    """A path-traced image (linear radiance) of a scene, and its render time."""

    radiance: Float[np.ndarray, "h w 3"]
    seconds: float
    scene: Scene | PackedScene
    camera: Camera

    def shows(self, scene: Scene | PackedScene, camera: Camera, size: tuple[int, int]) -> bool:
        """Return whether it is an image of this view."""
        return self.scene is scene and self.camera == camera and self.radiance.shape[:2] == size


def path_trace(
    scene: Scene | PackedScene, camera: Camera, size: tuple[int, int], settings: CyclesSettings
) -> Reference:
    """Path-trace (height, width) pixels. Raises UserError if Blender is missing or cannot render the scene."""
    [([radiance], seconds)] = path_traced([pack(scene).seen_by([camera])], size, settings)
    return Reference(radiance, seconds, scene, camera)

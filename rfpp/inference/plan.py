"""Settings of a render, checked before any ray is cast."""

from __future__ import annotations

from dataclasses import dataclass

from rfpp.errors import SceneError, UserError
from rfpp.inference.memory import require_memory
from rfpp.scene.packed import PackedScene


@dataclass(frozen=True)
class Plan:
    """Settings of a render.

    Attributes:
        scene: Scene with at least one camera.
        size: (height, width) in pixels.
        light_samples: Shadow rays per light and pixel.
        points: Samples along each side of a pixel.
        transports: Applications of the transport operator, or bounces between cells; None for the usual number.
    """

    scene: PackedScene
    size: tuple[int, int]
    light_samples: int = 16
    points: int = 2
    transports: int | None = None

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            SceneError: If the scene has no camera.
            UserError: If there are no samples, or the image takes more memory than there is.
        """
        if not len(self.scene.fov):
            raise SceneError(f"scene '{self.scene.name}' has no camera: add one to its `cameras`")
        if min(self.light_samples, self.points) < 1:
            given = f"light_samples={self.light_samples}, supersampling={self.points}"
            raise UserError(f"{given}: give 1 or more of each")
        require_memory(*self.size, self.points)


def image_size(resolution: int | tuple[int, int], patch_size: int) -> tuple[int, int]:
    """Return (height, width) of a resolution.

    Raises:
        UserError: If it does not divide into patches.
    """
    height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
    if min(height, width) < 1 or height % patch_size or width % patch_size:
        raise UserError(f"resolution {width} x {height} does not divide into patches of {patch_size}: use multiples")
    return height, width

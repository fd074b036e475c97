"""Settings of a render, checked before any ray is cast."""

from __future__ import annotations

import math
from dataclasses import dataclass

import psutil

from rfpp.errors import SceneError, UserError
from rfpp.scene.packed import PackedScene

#: Memory of a shading point beside the network, measured at 256² and 512² pixels with 2 × 2 points each.
_BYTES_PER_POINT = 1200


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
        """Raise UserError if there is no camera or sample, or the image takes more memory than there is."""
        if not len(self.scene.fov):
            raise SceneError(f"scene '{self.scene.name}' has no camera: add one to its `cameras`")
        if min(self.light_samples, self.points) < 1:
            given = f"light_samples={self.light_samples}, supersampling={self.points}"
            raise UserError(f"{given}: give 1 or more of each")
        require_memory(*self.size, self.points)


def image_size(resolution: int | tuple[int, int], patch_size: int) -> tuple[int, int]:
    """Return (height, width) of a resolution. Raises UserError if it does not divide into patches."""
    height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
    if min(height, width) < 1 or height % patch_size or width % patch_size:
        raise UserError(f"resolution {width} x {height} does not divide into patches of {patch_size}: use multiples")
    return height, width


def require_memory(height: int, width: int, points: int, bytes_per_point: int = _BYTES_PER_POINT) -> None:
    """Raise UserError if an image with this number of samples along each side of a pixel exceeds the free memory."""
    needed, free = height * width * points**2 * bytes_per_point, psutil.virtual_memory().available
    if needed > free:
        side = math.isqrt(free // (points**2 * bytes_per_point)) // 64 * 64
        raise UserError(
            f"resolution {width} x {height}: takes about {needed / 2**30:,.0f} GB of memory, {free / 2**30:,.0f} are "
            f"free: reduce it, {side} x {side} fits"
        )

"""Labels of a scene for training: its images, and light at its surfaces."""

from __future__ import annotations

from typing import NamedTuple, Protocol, SupportsInt, runtime_checkable

import numpy as np
from jaxtyping import Float

from rfpp.scene.triangles import SceneTriangles


class Labels(NamedTuple):
    """Labels of a scene.

    Attributes:
        images: [V, H, W, 3] linear radiance of each view.
        token_light: [O, 8, K + 1, 3] mean of irradiance / π over each object's surfaces that face an octant of
            directions, after k bounces; NaN where there are none. None if nothing is known of surfaces.
    """

    images: Float[np.ndarray, "v h w 3"]
    token_light: Float[np.ndarray, "o 8 k 3"] | None = None


@runtime_checkable
class LabelSource(Protocol):
    """Source of labels other than `CyclesSettings`, which it may use for some splits."""

    seed: int

    def labels(
        self,
        split: str,
        triangles: SceneTriangles,
        c2w: Float[np.ndarray, "v 4 4"],
        fov: Float[np.ndarray, " v"],
        resolution: SupportsInt,
        noise: SupportsInt,
    ) -> Labels:
        """Return the labels of square views; `noise` seeds the random numbers."""

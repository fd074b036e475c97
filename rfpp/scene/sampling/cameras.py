"""Random cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpp.ranges import Positive
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform
from rfpp.scene.sampling.open_region import OpenRegion
from rfpp.scene.spec import Camera


@dataclass(frozen=True)
class CameraSampler(HasIntervals):
    """Cameras on a shell around the scene's center, in front of the background.

    Attributes:
        target_jitter: displacement of the target from the scene's center, per axis.
        up_jitter: displacement of the up vector from +z, per axis.
        fov: full angle in degrees along the longer image side.
        elevation: degrees above the horizon, seen from the target.
        clearance: minimum distance of a camera to the plane of every panel.
    """

    count: Positive
    distance: Interval
    target_jitter: Interval
    up_jitter: Interval
    fov: Interval
    elevation: Interval
    clearance: float

    def sample(self, rng: np.random.Generator, open_region: OpenRegion) -> tuple[Camera, ...]:
        """Draw `count` independent cameras."""
        return tuple(self._camera(rng, open_region) for _ in range(self.count))

    def _camera(self, rng: np.random.Generator, open_region: OpenRegion) -> Camera:
        target = uniform(rng, self.target_jitter, 3)
        position = open_region.draw_position(
            rng,
            target=target,
            distance=uniform(rng, self.distance),
            elevation=self.elevation,
            clearance=self.clearance,
            others=np.empty((0, 3)),
            spacing=0.0,
        )
        up = np.array([0.0, 0.0, 1.0]) + uniform(rng, self.up_jitter, 3)
        return Camera(
            position=tuple(position.tolist()),
            look_at=tuple(target.tolist()),
            up=tuple(up.tolist()),
            fov=uniform(rng, self.fov),
        )

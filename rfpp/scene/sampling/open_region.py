"""The convex space in front of a background's floor and walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.sampling.interval import Interval

_ATTEMPTS = 2000


@dataclass(frozen=True, eq=False)
class OpenRegion:
    """Intersection of half-spaces, one per panel (taken as infinite), the floor first.

    The region is convex, so no panel hides points in it from each other: cameras and lights in it see their targets.

    Attributes:
        normals: [P, 3] unit normals that point into the region.
        offsets: [P]; a point p is in front of panel i if normals[i]·p > offsets[i].
    """

    normals: Float[np.ndarray, "panels 3"]
    offsets: Float[np.ndarray, " panels"]

    def distances(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch panels"]:
        """Return signed distances of points to every panel's plane, positive in front."""
        return points @ self.normals.T - self.offsets

    def draw_position(
        self,
        rng: np.random.Generator,
        target: Float[np.ndarray, 3],
        distance: float,
        elevation: Interval,
        clearance: float,
        others: Float[np.ndarray, "count 3"],
        spacing: float,
    ) -> Float[np.ndarray, 3]:
        """Draw a position at `distance` from `target`, uniformly over the valid directions.

        A direction is valid if its elevation (degrees above the horizon, seen from the target) is in the interval, and
        the position is at least `clearance` in front of every panel and more than `spacing` away from `others`.

        Raises:
            SceneError: If no valid position is found.
        """
        low, high = np.sin(np.radians(elevation))
        for _ in range(_ATTEMPTS):
            height, azimuth = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)  # equal areas
            level = np.sqrt(1 - height**2)
            position = target + distance * np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
            is_free = (np.linalg.norm(others - position, axis=1) > spacing).all()
            if is_free and (self.distances(position) > clearance).all():
                return position
        raise SceneError(
            f"no position {distance:.3g} from {np.round(target, 3).tolist()} lies in front of the background and "
            f"{spacing:g} from {len(others)} others: widen the elevation or lower clearance, spacing or count"
        )

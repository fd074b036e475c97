"""Place objects without intersections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.ranges import PartOfMany, Positive, Share
from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.interval import HasIntervals, Interval, uniform
from rfpp.scene.sampling.open_region import OpenRegion
from rfpp.scene.sampling.sizes import SizeSampler
from rfpp.scene.spec import Transform, rotation_matrix

#: Objects stay inside [-0.5, 0.5]^3.
_HALF_EXTENT = 0.5
_SHRINKS = 60


@dataclass(frozen=True)
class Placement(HasIntervals):
    """Rejection sampling of positions, the largest object first.

    Attributes:
        sizes: sizes of the objects, reduced where there is no room.
        rotation: degrees about each axis.
        floating: probability that an object floats above the floor instead of resting on it.
        gap: distance of a resting object's lowest vertex to the floor.
        margin: minimum distance between the bounding boxes of two objects, and between an object and a wall.
        attempts: positions tried before an object is shrunk.
        shrink: factor of its size after all attempts failed.
    """

    sizes: SizeSampler
    rotation: Interval
    floating: Share
    gap: float
    margin: float
    attempts: Positive
    shrink: PartOfMany

    def sample(self, rng: np.random.Generator, meshes: Sequence[Mesh], open_region: OpenRegion) -> list[Transform]:
        """Return one transform per normalized mesh, in order.

        Raises:
            SceneError: If there is no room for a mesh at any size.
        """
        radii = self.sizes.sample(rng, len(meshes))
        boxes = np.empty((0, 2, 3))
        transforms: list[Transform | None] = [None] * len(meshes)
        for i in np.argsort(-radii, kind="stable"):
            transforms[i], box = self._placed(rng, meshes[i], radii[i], open_region, boxes)
            boxes = np.concatenate([boxes, box[None]])
        return transforms

    def _placed(
        self, rng: np.random.Generator, mesh: Mesh, radius: float, open_region: OpenRegion, boxes: np.ndarray
    ) -> tuple[Transform, np.ndarray]:
        """Return a transform clear of the panels and of the boxes [N, 2, 3], and the object's world box [2, 3]."""
        rotation = self._rotation(rng)
        floats = rng.random() < self.floating
        rotated = mesh.vertices @ rotation_matrix(tuple(rotation)).T
        unit_box = np.stack([rotated.min(axis=0), rotated.max(axis=0)])
        unit_reach = (rotated @ open_region.normals.T).min(axis=0)  # [P] of the vertex closest to each panel
        scale = 2 * radius  # a normalized mesh has radius 0.5
        for _ in range(_SHRINKS):
            box, reach = scale * unit_box, scale * unit_reach
            centers = self._candidates(rng, box, reach, open_region, floats)
            fits = self._fits(centers, box, reach, open_region, boxes)
            if fits.any():
                center = centers[fits.argmax()]
                transform = Transform(
                    translation=tuple(center.tolist()),
                    rotation=tuple(rotation.tolist()),
                    scale=(float(scale),) * 3,
                    normalize=False,  # the source has normalized the mesh
                )
                return transform, box + center
            scale *= self.shrink
        raise SceneError("an object found no room: lower Placement.sizes, margin or the number of objects")

    def _rotation(self, rng: np.random.Generator) -> Float[np.ndarray, 3]:
        return uniform(rng, self.rotation, 3)

    def _candidates(
        self, rng: np.random.Generator, box: np.ndarray, reach: np.ndarray, open_region: OpenRegion, floats: bool
    ) -> np.ndarray:
        """Draw centers [attempts, 3] inside the cube sideways, resting on the floor or floating above it."""
        low, high = np.minimum(-_HALF_EXTENT - box[0], 0), np.maximum(_HALF_EXTENT - box[1], 0)
        centers = rng.uniform(low, high, (self.attempts, 3))
        normal, offset = open_region.normals[0], open_region.offsets[0]
        resting = (offset + self.gap - reach[0] - centers[:, :2] @ normal[:2]) / normal[2]
        if floats:
            resting = resting + rng.random(self.attempts) * np.maximum(high[2] - resting, 0)
        centers[:, 2] = resting
        return centers

    def _fits(
        self, centers: np.ndarray, box: np.ndarray, reach: np.ndarray, open_region: OpenRegion, boxes: np.ndarray
    ) -> np.ndarray:
        """Return a mask [attempts] of centers inside the cube, in front of every wall and clear of every box."""
        low, high = centers + box[0], centers + box[1]
        inside = ((low >= -_HALF_EXTENT) & (high <= _HALF_EXTENT)).all(axis=1)
        in_front = (open_region.distances(centers)[:, 1:] + reach[1:] >= self.margin).all(axis=1)
        apart = (low[:, None] > boxes[:, 1] + self.margin) | (high[:, None] < boxes[:, 0] - self.margin)
        return inside & in_front & apart.any(axis=2).all(axis=1)


@dataclass(frozen=True)
class UprightPlacement(Placement):
    """Placement of furniture: most objects rotate only about the vertical axis."""

    upright: Share

    def _rotation(self, rng: np.random.Generator) -> Float[np.ndarray, 3]:
        rotation = super()._rotation(rng)
        return rotation * (0, 0, 1) if rng.random() < self.upright else rotation

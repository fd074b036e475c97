"""Random changes of stored scenes whose images are known: rigid motion and permuted colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rfpp.batch import SceneViews
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR, SceneTriangles


@dataclass(frozen=True)
class RigidAugmentation:
    """Random rigid motion of scene and cameras; images and camera-space G-buffers do not change.

    RSPE makes the network indifferent to translations but not to rotations (RenderFormer trains so too).

    Args:
        rotation: standard deviation of each component of the rotation vector, radians.
        translation: standard deviation of each component of the translation, world units.
    """

    rotation: float
    translation: float

    def __call__(self, views: SceneViews, rng: np.random.Generator) -> SceneViews:
        turn = Rotation.from_rotvec(rng.normal(0, self.rotation, 3)).as_matrix()
        shift = rng.normal(0, self.translation, 3)
        return moved(views, turn, shift)


def moved(views: SceneViews, rotation: np.ndarray, translation: np.ndarray) -> SceneViews:
    """Scene and cameras after p → rotation · p + translation."""
    old, turn = views.triangles, rotation.T.astype(np.float32)
    triangles = SceneTriangles(
        positions=(old.positions.reshape(-1, 3) @ turn + translation.astype(np.float32)).reshape(-1, 3, 3),
        normals=(old.normals.reshape(-1, 3) @ turn).reshape(-1, 3, 3),
        material=old.material,
        object_offsets=old.object_offsets,
        object_names=old.object_names,
    )
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = rotation, translation
    return replace(views, triangles=triangles, c2w=(move @ views.c2w).astype(np.float32))


class ColourPermutation:
    """Random permutation of the colour channels of materials, lights and images.

    Not in the paper, whose data set is two thousand times quickstart's.
    """

    def __call__(self, views: SceneViews, channels: Sequence[str], rng: np.random.Generator) -> SceneViews:
        order = rng.permutation(3)
        material = views.triangles.material.copy()
        for colour in (DIFFUSE, SPECULAR, EMISSION):
            material[:, colour] = material[:, colour][:, order]
        gbuffer, start = views.gbuffer.copy(), 0
        for name in channels:
            if name in COLOR_CHANNELS:
                gbuffer[:, start : start + 3] = gbuffer[:, start : start + 3][:, order]
            start += CHANNELS[name]
        triangles = replace(views.triangles, material=material)
        return replace(views, triangles=triangles, gbuffer=gbuffer, image=views.image[:, order])

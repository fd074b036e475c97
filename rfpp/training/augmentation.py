"""Random changes of stored views with known images: rigid motion and permuted colors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from rfpp.batch import SceneViews
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR


@runtime_checkable
class Augmentation(Protocol):
    """Random change of a scene's views; `channels` names their G-buffer channels in order."""

    def __call__(self, views: SceneViews, channels: Sequence[str], rng: np.random.Generator) -> SceneViews: ...


@dataclass(frozen=True)
class RigidMotion:
    """Random rigid motion of scene and cameras; images and camera-space G-buffers do not change.

    RSPE makes the network invariant to translations but not to rotations. RenderFormer uses this augmentation.

    Attributes:
        rotation: standard deviation of each component of the rotation vector, radians.
    """

    rotation: float
    translation: float

    def __call__(self, views: SceneViews, channels: Sequence[str], rng: np.random.Generator) -> SceneViews:
        rotation = Rotation.from_rotvec(rng.normal(0, self.rotation, 3)).as_matrix()
        return moved(views, rotation, rng.normal(0, self.translation, 3))


def moved(views: SceneViews, rotation: np.ndarray, translation: np.ndarray) -> SceneViews:
    """Map scene and cameras by p → rotation · p + translation."""
    old, turn = views.triangles, rotation.T.astype(np.float32)
    positions = (old.positions.reshape(-1, 3) @ turn + translation.astype(np.float32)).reshape(-1, 3, 3)
    triangles = replace(old, positions=positions, normals=(old.normals.reshape(-1, 3) @ turn).reshape(-1, 3, 3))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, translation
    return replace(views, triangles=triangles, c2w=(motion @ views.c2w).astype(np.float32))


class ColorPermutation:
    """Random permutation of the color channels of materials, lights, G-buffers and images. Not in the paper."""

    def __call__(self, views: SceneViews, channels: Sequence[str], rng: np.random.Generator) -> SceneViews:
        order = rng.permutation(3)
        material = views.triangles.material.copy()
        for color in (DIFFUSE, SPECULAR, EMISSION):
            material[:, color] = material[:, color][:, order]
        gbuffer, start = views.gbuffer.copy(), 0
        for name in channels:
            if name in COLOR_CHANNELS:
                gbuffer[:, start : start + 3] = gbuffer[:, start : start + 3][:, order]
            start += CHANNELS[name]
        triangles = replace(views.triangles, material=material)
        return replace(views, triangles=triangles, gbuffer=gbuffer, image=views.image[:, order])

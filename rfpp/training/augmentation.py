"""Random changes of stored scenes whose images are known: rigid motion, permuted colours, mixed lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rfpp.batch import SceneViews
from rfpp.errors import UserError
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR, SceneTriangles
from rfpp.shards.mixing import mixed
from rfpp.shards.sample import SceneSample


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
    cells = None if views.cells is None else views.cells.moved(rotation, translation)
    return replace(views, triangles=triangles, c2w=(move @ views.c2w).astype(np.float32), cells=cells)


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
        light = views.object_light[:, order]
        cells = None if views.cells is None else views.cells.recoloured(order)
        image = views.image[:, order]
        return replace(views, triangles=triangles, gbuffer=gbuffer, image=image, object_light=light, cells=cells)


@dataclass(frozen=True)
class LightMixing:
    """Gives every light of a stored scene another intensity and colour; references and known light follow exactly.

    For data sets that hold the light of each light apart (`data.by_light`). Not in the paper.

    Args:
        power: intensities are multiplied by 1 / power to power, uniformly in their logarithm.
        saturation: 0 leaves lights' colours as they are; else red, green and blue are multiplied each by a number
            between 1 - saturation and 1.

    Raises:
        UserError: a power below 1, or a saturation that is not between 0 and 1.
    """

    power: float | int
    saturation: float | int

    def __post_init__(self) -> None:
        if self.power < 1 or not 0 <= self.saturation < 1:
            raise UserError(
                f"light_augmentation: power={self.power}, saturation={self.saturation}: use a power of 1 or more and a "
                "saturation from 0 to below 1"
            )

    def __call__(self, sample: SceneSample, rng: np.random.Generator) -> SceneSample:
        """Raises ShardError for a sample whose lights are not stored apart."""
        lights = sample.triangles.num_lights
        power = self.power ** rng.uniform(-1, 1, (lights, 1))
        return mixed(sample, power * rng.uniform(1 - self.saturation, 1, (lights, 3)))

"""Data sets with synthetic images, which are as large and as hard to compress as rendered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from rfpp.raycast.first_hit import camera_caster, channel, first_hit
from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.farm import RenderFarm
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.generation import generate
from rfpp.shards.job import DatasetSettings, SceneSource
from rfpp.shards.recipe import Recipe

#: Standard deviation of log radiance: noise that remains after denoising.
_NOISE = 0.01


@dataclass(frozen=True)
class SyntheticData:
    """First training scenes of a family, with synthetic images.

    Attributes:
        data: Settings of the data set; name, folder and number of scenes are replaced.
        reference: Settings of Cycles, of which only the seed is used.
    """

    family: SceneSource
    data: DatasetSettings
    reference: CyclesSettings
    farm: RenderFarm
    scenes: int

    def write(self, folder: Path, progress: Callable[[int, int], None]) -> None:
        """Write the data set into a folder."""
        data = replace(self.data, name="synthetic", root=str(folder), splits={"train": self.scenes})
        recipe = Recipe.of_scenes(self.family, self.reference, data, {}, synthetic_images)
        with self.farm as farm:
            generate(recipe, farm, progress)


def synthetic_images(
    triangles: SceneTriangles, c2w: np.ndarray, fov: np.ndarray, height: int, width: int, settings: CyclesSettings
) -> Float[np.ndarray, "v height width 3"]:
    """Return albedo times headlight and smooth indirect light, with noise; same signature as `cycles.render`."""
    rng, caster = np.random.default_rng(settings.seed), camera_caster(triangles)
    images = []
    for pose, angle in zip(c2w, fov, strict=True):
        hit = first_hit(triangles, pose, angle, height, width, caster)
        albedo = channel(hit, triangles.material, angle, "albedo")
        headlight = albedo * np.maximum(hit.normal[..., 2:], 0)
        light = headlight + albedo * gaussian_filter(headlight, (height / 16, width / 16, 0))
        images.append(light * np.exp(rng.normal(0, _NOISE, light.shape)))
    return np.stack(images).astype(np.float32)

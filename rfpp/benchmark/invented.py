"""Synthetic data sets, as large and as hard to compress as rendered ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import camera_caster, channel, first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.farm import RenderFarm
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.generation import generate
from rfpp.shards.job import DatasetSettings, SceneSource
from rfpp.shards.recipe import Recipe

#: What denoising leaves: standard deviation of log radiance.
_NOISE = 0.01


@dataclass(frozen=True)
class InventedData:
    """The first training scenes of a family, with invented indirect light.

    Attributes:
        family: of the scenes.
        data: resolution, views and so on; name, place and amount are replaced.
        reference: only its noise seed matters.
        farm: makes the samples.
        scenes: how many.
    """

    family: SceneSource
    data: DatasetSettings
    reference: CyclesSettings
    farm: RenderFarm
    scenes: int

    def root(self, temporary: Path, progress: Callable[[int, int], None]) -> Path:
        """Make the data set in a temporary folder; returns it."""
        data = replace(self.data, name="invented", root=str(temporary), splits={"train": self.scenes})
        recipe = Recipe.of_scenes(self.family, self.reference, data, {}, invented_light)
        with self.farm as farm:
            generate(recipe, farm, progress)
        return temporary


@dataclass(frozen=True)
class StoredData:
    """A data set that is there.

    Attributes:
        folder: of the data set.
    """

    folder: str

    def root(self, temporary: Path, progress: Callable[[int, int], None]) -> Path:
        """Its folder."""
        return Path(self.folder)


def invented_light(
    triangles: SceneTriangles, c2w: np.ndarray, fov: np.ndarray, height: int, width: int, settings: CyclesSettings
) -> np.ndarray:
    """Images [V, H, W, 3] of direct light, a smooth bounce of it, and a little noise (as `cycles.render`)."""
    rng = np.random.default_rng(settings.seed)
    caster, lights = camera_caster(triangles), LightSampler(triangles)
    images = []
    for pose, angle in zip(c2w, fov, strict=True):
        seen = first_hit(triangles, pose, angle, height, width, caster)
        lit = with_known_light(seen, pose, angle, lights, 2, int(rng.integers(1 << 31)), reflects=False)
        direct = direct_radiance(lit, triangles.material)
        albedo = channel(lit, triangles.material, angle, "albedo")
        bounce = albedo * gaussian_filter(direct, (height / 16, width / 16, 0))
        noise = np.exp(rng.normal(0, _NOISE, direct.shape))
        images.append(np.minimum((direct + bounce) * noise, np.finfo(np.float16).max))
    return np.stack(images).astype(np.float32)

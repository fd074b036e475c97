"""A data set that takes no time: a box on a floor, and a renderer that invents plausible numbers."""

import json
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.farm import RenderFarm
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform
from rfpp.shards.acceptance import Acceptance
from rfpp.shards.generation import generate
from rfpp.shards.job import DatasetSettings
from rfpp.shards.manifest import Manifest
from rfpp.shards.recipe import Recipe

FLOOR = Mesh(np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
LIGHT = Mesh(np.array([[-0.03, 0, 2], [0.03, 0, 2], [0, 0.05, 2]]), np.array([[0, 2, 1]]))
PEAK = Mesh(
    np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0, 0.1, 0], [0, 0, 0.2]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
)

REFERENCE = CyclesSettings(
    samples=1, adaptive_threshold=0.0, denoise=False, max_bounces=2, diffuse_bounces=1, glossy_bounces=1,
    clamp_direct=0.0, clamp_indirect=0.0, caustics=False, blur_glossy=0.0, light_threshold=0.0, filter_width=1.5,
    seed=0, threads=0,
)  # fmt: skip


@dataclass(frozen=True)
class BoxFamily:
    """A peak of random place and color on a floor; some cameras look into the void, some scenes are dark."""

    views: int = 2
    looks_away: float = 0.0  # probability per camera
    night: float = 0.0  # probability per scene
    name: str = "boxes"

    def sample(self, scene_rng, camera_rng, *, held_out) -> Scene:
        fixed = Transform(normalize=False)
        place = Transform(normalize=False, translation=tuple(scene_rng.uniform(-0.2, 0.2, 3)))
        color = Material(diffuse=tuple(scene_rng.uniform(0, 0.8, 3)), specular=(0.1,) * 3, roughness=0.5)
        gray = Material(diffuse=(0.5,) * 3, specular=(0.2,) * 3, roughness=0.3, smooth_shading=True)
        power = 0.001 if scene_rng.random() < self.night else 3000.0
        lamp = Material(diffuse=(1.0,) * 3, specular=(0.0,) * 3, roughness=1.0, emissive=(power,) * 3)
        parts = [("floor", FLOOR, gray, fixed), ("peak", PEAK, color, place), ("light", LIGHT, lamp, fixed)]
        return Scene(
            name=self.name,
            objects=tuple(SceneObject(name=n, mesh=m, material=a, transform=t) for n, m, a, t in parts),
            cameras=self.sample_cameras(scene_rng, camera_rng),
        )

    def sample_cameras(self, scene_rng, camera_rng) -> tuple[Camera, ...]:
        return tuple(self._camera(camera_rng) for _ in range(self.views))

    def _camera(self, rng) -> Camera:
        away = rng.uniform() < self.looks_away
        position = (*rng.uniform(-0.5, 0.5, 2), 1.5)
        return Camera(position=position, look_at=(0, 0, 9 if away else 0), up=(0, 1, 0.1), fov=45)


def invented(triangles, c2w, fov, height, width, settings) -> np.ndarray:
    """Noise around a level that depends on the scene's color."""
    noise = np.random.default_rng(settings.seed).exponential(1.0, (len(c2w), height, width, 3))
    level = triangles.material[2, :3] + 0.1
    return (noise * level).astype(np.float16).astype(np.float32)


@dataclass(frozen=True)
class Interrupting:
    """`invented`, but raises while the file `flag` exists and the scene's red lies below `below`."""

    flag: Path
    below: float

    def __call__(self, triangles, *args) -> np.ndarray:
        if self.flag.exists() and triangles.material[2, 0] < self.below:
            raise RuntimeError("the renderer fell over")
        return invented(triangles, *args)


@dataclass(frozen=True)
class Constant:
    """The same radiance everywhere."""

    value: float

    def __call__(self, triangles, c2w, fov, height, width, settings) -> np.ndarray:
        return np.full((len(c2w), height, width, 3), self.value, np.float32)


ACCEPTANCE = Acceptance(
    resolution=8, light_samples=1, min_coverage=0.4, min_lit=0.3, min_radiance=0.01, camera_attempts=20,
    scene_attempts=10,
)  # fmt: skip

SETTINGS = DatasetSettings(
    name="small", root="", seed=7, resolution=8, views=2, light_samples=2,
    splits={"train": 5, "train_newviews": 3, "test": 2}, scenes_per_shard=2, acceptance=ACCEPTANCE,
)  # fmt: skip


def recipe(root: Path, family=None, render=invented, groups=None, reference=REFERENCE, **data) -> Recipe:
    """For a data set in `root`, with `data` replacing some of SETTINGS."""
    dataset = replace(SETTINGS, root=str(root), **data)
    family, groups = family or BoxFamily(), groups or {"scene": "boxes"}
    return Recipe.of_scenes(family, reference, dataset, groups, render)


class InProcess(RenderFarm):
    """Jobs run here, once each: a worker takes seconds to start."""

    def __init__(self) -> None:
        super().__init__(1)

    def map(self, job, items: Iterable, attempts: int = 1) -> Iterator:
        job = pickle.loads(pickle.dumps(job))
        for item in items:
            try:
                yield item, job(item)
            except Exception as error:
                yield item, error


def make(root: Path, *args, progress=lambda done, total: None, workers=0, **kwargs) -> Manifest:
    """The finished data set of `recipe(root, ...)`, made by so many processes; 0 is this one."""
    with RenderFarm(workers) if workers else InProcess() as farm:
        return generate(recipe(root, *args, **kwargs), farm, progress)


class InterruptAfter:
    """A progress callback that is Ctrl-C after `count` new scenes."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __call__(self, done: int, total: int) -> None:
        if done >= self.count:
            raise KeyboardInterrupt


def hashes(root: Path) -> dict[str, str]:
    """File → sha256 of every shard in the manifest."""
    content = json.loads((root / "manifest.json").read_text())
    return {shard["file"]: shard["sha256"] for shards in content["splits"].values() for shard in shards}

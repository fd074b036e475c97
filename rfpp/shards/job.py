"""Making one sample: draw a scene, check what its cameras see, render, check the light, pack."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rfpp.errors import SceneError, UserError
from rfpp.gbuffer.direct_light import with_direct_light
from rfpp.gbuffer.first_hit import GBuffer, camera_caster, first_hit
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.raycast import RayCaster
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera, Scene
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.sample import SceneSample, encode
from rfpp.shards.tar import pack

#: Part of every seed: never renumber. `train_newviews` shows training scenes to other cameras.
SPLIT_CODES = {"train": 0, "train_newviews": 1, "test": 2, "validation": 3}
_ROLES = {"scene": 0, "cameras": 1, "render": 2, "light": 3}


@runtime_checkable
class SceneSource(Protocol):
    """Draws scenes: geometry, materials and lights from one rng, cameras from the other; test scenes are held out."""

    def sample(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator, *, held_out: bool) -> Scene: ...


@dataclass(frozen=True)
class DatasetSettings:
    """What to make and where. Values live in conf/data/*.yaml.

    Attributes:
        name: of the data set.
        root: folder to write.
        seed: non-negative; with split and index it determines every scene.
        resolution: images are square, this many pixels wide.
        views: cameras per scene.
        light_samples: shadow rays per light and pixel of the G-buffers' direct light.
        splits: scenes in each split of `SPLIT_CODES`; "train_newviews" are the first training scenes, other cameras.
        scenes_per_shard: scenes in one tar.
        workers: render processes; 0 is one per core.
        min_coverage: a camera that sees surfaces in less than this share of its pixels is redrawn.
        min_radiance: a scene whose images are darker than this in the mean is drawn anew.
        camera_attempts: draws of a camera, before its scene is drawn anew.
        scene_attempts: draws of a scene, before it counts as failed.
    """

    name: str
    root: str
    seed: int
    resolution: int
    views: int
    light_samples: int
    splits: Mapping[str, int]
    scenes_per_shard: int
    workers: int
    min_coverage: float
    min_radiance: float
    camera_attempts: int
    scene_attempts: int

    def __post_init__(self) -> None:
        for name in ("resolution", "views", "light_samples", "scenes_per_shard", "camera_attempts", "scene_attempts"):
            if getattr(self, name) < 1:
                raise UserError(f"data.{name} is {getattr(self, name)}: use 1 or more")
        if self.seed < 0:
            raise UserError(f"data.seed is {self.seed}: use 0 or more")
        if not 0 <= self.min_coverage <= 1:
            raise UserError(f"data.min_coverage is {self.min_coverage}: use 0 to 1")
        if unknown := set(self.splits) - set(SPLIT_CODES):
            raise UserError(f"data.splits.{min(unknown)} does not exist: choose from {', '.join(SPLIT_CODES)}")
        if negative := [split for split, count in self.splits.items() if count < 0]:
            raise UserError(f"data.splits.{negative[0]} is {self.splits[negative[0]]}: use 0 or more")
        if self.splits.get("train_newviews", 0) > self.splits.get("train", 0):
            raise UserError("data.splits.train_newviews is larger than data.splits.train, whose scenes it shows")

    def content(self) -> dict[str, Any]:
        """What the samples depend on: not the place, the amount or the number of workers."""
        others = ("name", "root", "splits", "workers")
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in others}


@dataclass(frozen=True)
class SceneTask:
    """One sample to make. `scene_attempt` pins the draw of the scene, else it is the first acceptable one."""

    split: str
    index: int
    scene_attempt: int | None = None

    @property
    def key(self) -> str:
        return f"{self.split}-{self.index:06d}"

    @property
    def scene_split(self) -> str:
        """The split whose scene this is."""
        return "train" if self.split == "train_newviews" else self.split


@dataclass(frozen=True)
class MadeScene:
    """A finished sample as tar blocks, with what the index records of it (`rfpp.shards.index.SampleEntry`)."""

    blocks: bytes
    triangles: int
    objects: int
    scene_redraws: int
    empty_views: int
    unlit_views: int


@dataclass(frozen=True)
class SceneJob:
    """Makes samples; picklable, so that worker processes can run it.

    Attributes:
        family: where scenes come from.
        reference: Cycles settings; the noise seed is replaced by one per sample.
        data: what a sample looks like and what makes one acceptable.
        fingerprint: of all settings, stored in each sample.
        render: with the signature of `rfpp.reference.cycles.render`.
    """

    family: SceneSource
    reference: CyclesSettings
    data: DatasetSettings
    fingerprint: str
    render: Callable[..., np.ndarray]

    def __call__(self, task: SceneTask) -> MadeScene:
        """Draw until cameras see enough and the images are lit. Raises SceneError when the attempts run out.

        A pinned scene was accepted before: what its new cameras see counts, its brightness does not.
        """
        pinned = task.scene_attempt is not None
        empty_views = 0
        for attempt in [task.scene_attempt] if pinned else range(self.data.scene_attempts):
            scene, gbuffers, rejected = self._draw(task, attempt)
            empty_views += rejected
            if len(gbuffers) < self.data.views:
                continue
            triangles = SceneTriangles.from_scene(scene)
            c2w = np.stack([camera_to_world(camera) for camera in scene.cameras])
            fov = np.array([camera.fov for camera in scene.cameras], np.float32)
            images = self._render(task, attempt, triangles, c2w, fov)
            if pinned or not images.mean() < self.data.min_radiance:  # NaN goes on, to be reported by `encode`
                redraws = {"scene_redraws": attempt, "empty_views": empty_views, "unlit_views": 0}
                lit = self._with_light(task, attempt, triangles, gbuffers, c2w, fov)
                sample = SceneSample(task.key, triangles, c2w, fov, images, lit, self._meta(task, scene, redraws))
                return _packed(sample, redraws)
        raise SceneError(
            f"{task.key}: no acceptable views in {self.data.scene_attempts} scenes x {self.data.camera_attempts} "
            "camera draws: lower data.min_coverage or data.min_radiance, or allow more attempts"
        )

    def _draw(self, task: SceneTask, attempt: int) -> tuple[Scene, tuple[GBuffer, ...], int]:
        """A scene whose cameras were each redrawn until they see enough, what they see, and the number of redraws.

        There are fewer G-buffers than views if a camera ran out of attempts.
        """
        accepted: dict[int, tuple[Camera, GBuffer]] = {}
        drawn = 0
        for camera_attempt in range(self.data.camera_attempts):
            scene = self._sample(task, attempt, camera_attempt)
            if camera_attempt == 0:
                triangles = SceneTriangles.from_scene(scene)
                caster = camera_caster(triangles)
            for view, camera in enumerate(scene.cameras):
                if view not in accepted:
                    drawn += 1
                    gbuffer = self._first_hit(triangles, camera, caster)
                    if gbuffer.hit.mean() >= self.data.min_coverage:
                        accepted[view] = camera, gbuffer
            if len(accepted) == self.data.views:
                break
        cameras, gbuffers = zip(*(accepted[view] for view in sorted(accepted)), strict=True) if accepted else ((), ())
        return scene.model_copy(update={"cameras": cameras}), gbuffers, drawn - len(accepted)

    def _sample(self, task: SceneTask, attempt: int, camera_attempt: int) -> Scene:
        scene = self.family.sample(
            np.random.default_rng(self._seed(task.scene_split, task.index, "scene", attempt)),
            np.random.default_rng(self._seed(task.split, task.index, "cameras", attempt, camera_attempt)),
            held_out=task.scene_split == "test",
        )
        if len(scene.cameras) != self.data.views:
            raise UserError(f"the scene family draws {len(scene.cameras)} cameras, data.views is {self.data.views}")
        return scene

    def _first_hit(self, triangles: SceneTriangles, camera: Camera, caster: RayCaster) -> GBuffer:
        side = self.data.resolution
        return first_hit(triangles, camera_to_world(camera), camera.fov, side, side, caster)

    def _render(
        self, task: SceneTask, attempt: int, triangles: SceneTriangles, c2w: np.ndarray, fov: np.ndarray
    ) -> np.ndarray:
        # Noise of its own for every sample: a pattern common to all images could be learned.
        seed = self._seed(task.split, task.index, "render", attempt, self.reference.seed).generate_state(1)[0]
        settings = dataclasses.replace(self.reference, seed=int(seed >> 1))  # Cycles takes 31 bits
        return self.render(triangles, c2w, fov, self.data.resolution, self.data.resolution, settings)

    def _with_light(
        self,
        task: SceneTask,
        attempt: int,
        triangles: SceneTriangles,
        gbuffers: tuple[GBuffer, ...],
        c2w: np.ndarray,
        fov: np.ndarray,
    ) -> tuple[GBuffer, ...]:
        sampler = LightSampler(triangles)
        seeds = self._seed(task.split, task.index, "light", attempt).generate_state(len(gbuffers))
        views = zip(gbuffers, c2w, fov, seeds, strict=True)
        samples = self.data.light_samples
        return tuple(with_direct_light(g, m, f, sampler, samples, int(seed)) for g, m, f, seed in views)

    def _seed(self, split: str, index: int, role: str, attempt: int, detail: int = 0) -> np.random.SeedSequence:
        return np.random.SeedSequence([self.data.seed, SPLIT_CODES[split], index, _ROLES[role], attempt, detail])

    def _meta(self, task: SceneTask, scene: Scene, redraws: dict[str, int]) -> dict[str, Any]:
        return {
            "family": scene.name,
            "seed": self.data.seed,
            "split": task.split,
            "index": task.index,
            "redraws": redraws,
            "settings": self.fingerprint,
            "cameras": [camera.model_dump(mode="json") for camera in scene.cameras],
        }


def _packed(sample: SceneSample, redraws: Mapping[str, int]) -> MadeScene:
    return MadeScene(
        blocks=pack(sample.key, encode(sample)),
        triangles=len(sample.triangles),
        objects=sample.triangles.num_objects,
        **redraws,
    )

"""Make one sample: draw a scene, check its views, render, pack."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rfpp.errors import SceneError, UserError
from rfpp.files import is_plain_name
from rfpp.ranges import NonNegative, Positive
from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.labels import Labels, LabelSource
from rfpp.scene.packed import poses
from rfpp.scene.spec import Camera, Scene
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards import tar
from rfpp.shards.acceptance import EMPTY, UNLIT, Acceptance
from rfpp.shards.sample import SceneSample, encode
from rfpp.shards.scene_rays import SceneRays

#: Part of every seed: never renumber. `train_newviews` shows training scenes from other cameras.
SPLIT_CODES = {"train": 0, "train_newviews": 1, "test": 2, "validation": 3}
_ROLES = {"scene": 0, "cameras": 1, "render": 2, "light": 3}


@runtime_checkable
class SceneSource(Protocol):
    """Draws scenes: geometry, materials and lights from one rng, cameras from the other; test scenes are held out."""

    name: str

    def sample(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator, *, held_out: bool) -> Scene: ...

    def sample_cameras(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator) -> tuple[Camera, ...]: ...


@dataclass(frozen=True)
class DatasetSettings:
    """Size, location and contents of a data set. Values are in conf/data/*.yaml."""

    name: str
    root: str
    seed: NonNegative
    resolution: Positive
    views: Positive
    light_samples: Positive
    splits: Mapping[str, int]
    scenes_per_shard: Positive
    acceptance: Acceptance

    def __post_init__(self) -> None:
        if not is_plain_name(self.name):
            raise UserError(f"data.name is '{self.name}': use letters, digits, dots, dashes and underscores")
        for name in ("resolution", "views", "light_samples", "scenes_per_shard"):
            if getattr(self, name) < 1:
                raise UserError(f"data.{name} is {getattr(self, name)}: use 1 or more")
        if self.seed < 0:
            raise UserError(f"data.seed is {self.seed}: use 0 or more")
        for split, count in self.splits.items():
            if split not in SPLIT_CODES:
                raise UserError(f"data.splits.{split} does not exist: choose from {', '.join(SPLIT_CODES)}")
            if count < 0:
                raise UserError(f"data.splits.{split} is {count}: use 0 or more")
        if not any(self.splits.values()):
            raise UserError("data.splits: all are 0: give one of them a number of scenes")
        if self.splits.get("train_newviews", 0) > self.splits.get("train", 0):
            raise UserError("data.splits.train_newviews is larger than data.splits.train, whose scenes it shows")

    def content(self) -> dict[str, Any]:
        """Return the settings that samples depend on, without location and number of samples."""
        values = dataclasses.asdict(self)
        return {name: value for name, value in values.items() if name not in ("name", "root", "splits")}


@dataclass(frozen=True)
class SceneTask:
    """One sample to make."""

    split: str
    index: int

    @property
    def key(self) -> str:
        return f"{self.split}-{self.index:06d}"

    @property
    def scene_split(self) -> str:
        """Split that the scene belongs to."""
        return "train" if self.split == "train_newviews" else self.split


@dataclass(frozen=True)
class SampleBlocks:
    """A finished sample as tar blocks, with its counts for the index (`rfpp.shards.index.SampleEntry`)."""

    blocks: bytes
    triangles: int
    objects: int
    scene_redraws: int
    empty_views: int
    unlit_views: int

    @classmethod
    def of(cls, sample: SceneSample) -> SampleBlocks:
        """Pack a sample, whose meta data state the redraws. Raises ShardError (see `rfpp.shards.sample.encode`)."""
        blocks = tar.pack(sample.key, encode(sample))
        return cls(blocks, len(sample.triangles), sample.triangles.num_objects, **sample.meta["redraws"])


@dataclass(frozen=True)
class SceneJob:
    """Makes samples; picklable, so that worker processes can run it.

    A sample depends only on its task and these attributes; `render` has the signature of `cycles.render` and is used
    with Cycles' settings.
    """

    family: SceneSource
    reference: CyclesSettings | LabelSource
    data: DatasetSettings
    fingerprint: str
    render: Callable[..., np.ndarray]

    def __call__(self, task: SceneTask) -> SampleBlocks:
        """Draw until all views are accepted, then render. Raises SceneError after too many attempts."""
        rejected: Counter[str] = Counter()
        attempts = range(self.data.acceptance.scene_attempts)
        attempt, rays, cameras = self._accepted(task, task.scene_split, attempts, rejected)
        if task.split != task.scene_split:  # the scene accepted there, with new views; only these are counted here
            rejected.clear()
            attempt, rays, cameras = self._accepted(task, task.split, [attempt], rejected)
        c2w, fov = poses(cameras)
        resolution, light_seed = self.data.resolution, self._seed(task.split, task.index, "light", attempt)
        meta = {
            "family": self.family.name,
            "seed": self.data.seed,
            "split": task.split,
            "index": task.index,
            "redraws": {"scene_redraws": attempt, EMPTY: rejected[EMPTY], UNLIT: rejected[UNLIT]},
            "settings": self.fingerprint,
            "cameras": [camera.model_dump(mode="json") for camera in cameras],
        }
        # each sample has its own noise: a pattern common to all images could be learned
        noise = self._seed(task.split, task.index, "render", attempt, self.reference.seed).generate_state(1)[0]
        seed = int(noise >> 1)  # Cycles' seeds have 31 bits
        seen = rays.triangles, c2w, fov
        if isinstance(self.reference, CyclesSettings):
            settings = dataclasses.replace(self.reference, seed=seed)
            labels = Labels(self.render(*seen, resolution, resolution, settings))
        else:
            labels = self.reference.labels(task.split, *seen, resolution, seed)
        sample = SceneSample(
            key=task.key,
            triangles=rays.triangles,
            c2w=c2w,
            fov=fov,
            images=labels.images,
            gbuffers=rays.gbuffers(c2w, fov, resolution, self.data.light_samples, light_seed),
            meta=meta,
            token_light=labels.token_light,
        )
        return SampleBlocks.of(sample)

    def _accepted(
        self, task: SceneTask, split: str, attempts: Iterable[int], rejected: Counter[str]
    ) -> tuple[int, SceneRays, tuple[Camera, ...]]:
        """Return the first draw of the scene whose views for `split` are all accepted, and these views."""
        for attempt in attempts:
            rngs = self._rngs(task, split, attempt, camera_attempt=0)
            rays = SceneRays(SceneTriangles.from_scene(self.family.sample(*rngs, held_out=task.scene_split == "test")))
            cameras = self.data.acceptance.cameras(rays, partial(self._cameras, task, split, attempt), rejected)
            if cameras is not None:
                return attempt, rays, cameras
        acceptance = self.data.acceptance
        raise SceneError(
            f"{task.key}: no acceptable views in {acceptance.scene_attempts} scenes x {acceptance.camera_attempts} "
            f"camera draws ({rejected[EMPTY]} saw too little, {rejected[UNLIT]} too little light): lower "
            "data.acceptance.min_coverage, min_lit or min_radiance, or allow more attempts"
        )

    def _cameras(self, task: SceneTask, split: str, attempt: int, camera_attempt: int) -> tuple[Camera, ...]:
        cameras = self.family.sample_cameras(*self._rngs(task, split, attempt, camera_attempt))
        if len(cameras) != self.data.views:
            raise UserError(
                f"family.cameras.count={len(cameras)}: data.views is {self.data.views}: give data.views alone"
            )
        return cameras

    def _rngs(
        self, task: SceneTask, split: str, attempt: int, camera_attempt: int
    ) -> tuple[np.random.Generator, np.random.Generator]:
        scene = self._seed(task.scene_split, task.index, "scene", attempt)
        cameras = self._seed(split, task.index, "cameras", attempt, camera_attempt)
        return np.random.default_rng(scene), np.random.default_rng(cameras)

    def _seed(self, split: str, index: int, role: str, attempt: int, detail: int = 0) -> np.random.SeedSequence:
        return np.random.SeedSequence([self.data.seed, SPLIT_CODES[split], index, _ROLES[role], attempt, detail])

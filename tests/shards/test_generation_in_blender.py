"""Generation of data sets with Blender, also when its processes are killed."""

import os
import signal
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from marks import requires_blender
from small_data import REFERENCE, make, recipe

from rfpp.reference import cycles
from rfpp.reference.farm import RenderFarm
from rfpp.shards import generation
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest


@dataclass(frozen=True)
class Sabotaged:
    """Cycles, but the worker of the first scene is killed while rendering, and that of the second is stopped."""

    folder: Path

    def __call__(self, triangles, *args) -> np.ndarray:
        images = cycles.render(triangles, *args)
        seen = self.folder / f"{triangles.material[2, 0]}.seen"
        number = len(list(self.folder.glob("*.seen")))
        if number < 2 and not seen.exists():
            seen.touch()
            os.kill(os.getpid(), (signal.SIGKILL, signal.SIGSTOP)[number])
        return images


@requires_blender
def test_killed_and_hanging_workers_lose_nothing(tmp_path):
    def rendered(name: str, render) -> Manifest:
        with RenderFarm(1, max_job_seconds=20.0) as farm:
            reference = replace(REFERENCE, samples=4)
            made = recipe(tmp_path / name, render=render, reference=reference, resolution=32, splits={"train": 3})
            return generation.generate(made, farm, lambda done, total: None)

    sabotaged = rendered("sabotaged", Sabotaged(tmp_path))
    assert len(list(tmp_path.glob("*.seen"))) == 2
    assert sabotaged.hash == rendered("undisturbed", cycles.render).hash


@requires_blender
def test_two_tiny_scenes_with_blender(tmp_path):
    def rendered(name: str) -> Manifest:
        reference = replace(REFERENCE, samples=4)
        blender = {"render": cycles.render, "workers": 1}  # not in this process, which it would change
        return make(tmp_path / name, **blender, reference=reference, resolution=32, splits={"train": 2})

    manifest = rendered("once")
    train = ShardSplit(manifest.root, "train")
    for sample in (train[0], train[1]):
        assert sample.images.shape == (2, 32, 32, 3)
        seen = np.stack([gbuffer.hit for gbuffer in sample.gbuffers])
        assert np.median(sample.images[seen]) > 0.01, "the light must reach the floor"
    assert rendered("again").hash == manifest.hash

"""One small sample, as it comes out of a data set."""

import numpy as np
from small_data import BoxFamily

from rfpp.scene.packed import PackedScene, pack
from rfpp.shards.sample import SceneSample, decode, encode
from rfpp.shards.scene_rays import SceneRays


def stored_sample(scene: PackedScene | None = None, resolution: int = 16) -> SceneSample:
    """Return a sample of this scene, or of a box on a floor, with random images."""
    if scene is None:
        scene = pack(BoxFamily().sample(np.random.default_rng(1), np.random.default_rng(2), held_out=False))
    rays = SceneRays(scene.triangles)
    gbuffers = rays.gbuffers(scene.c2w, scene.fov, resolution, 2, np.random.SeedSequence(0))
    images = np.random.default_rng(3).exponential(0.5, (len(scene.fov), resolution, resolution, 3)).astype(np.float32)
    meta = {"family": "boxes", "index": 1, "redraws": {"scene_redraws": 2, "empty_views": 3, "unlit_views": 4}}
    sample = SceneSample("train-000001", scene.triangles, scene.c2w, scene.fov, images, gbuffers, meta)
    return decode(sample.key, encode(sample))

"""One small sample, as it comes out of a data set."""

import numpy as np
from small_data import BoxFamily

from rfpp.gbuffer.direct_light import with_direct_light
from rfpp.gbuffer.first_hit import first_hit
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.scene.packed import PackedScene, pack
from rfpp.shards.sample import SceneSample, decode, encode


def stored_sample(scene: PackedScene | None = None, resolution: int = 16) -> SceneSample:
    """Of this scene, or of a box on a floor, with invented images."""
    if scene is None:
        scene = pack(BoxFamily().sample(np.random.default_rng(1), np.random.default_rng(2), held_out=False))
    sampler = LightSampler(scene.triangles)
    gbuffers = tuple(
        with_direct_light(first_hit(scene.triangles, pose, fov, resolution, resolution), pose, fov, sampler, samples=2)
        for pose, fov in zip(scene.c2w, scene.fov, strict=True)
    )
    images = np.random.default_rng(3).exponential(0.5, (len(scene.fov), resolution, resolution, 3)).astype(np.float32)
    meta = {"family": "boxes", "index": 1, "redraws": {"scene_redraws": 2, "empty_views": 3, "unlit_views": 4}}
    key = "train-000001"
    return decode(key, encode(SceneSample(key, scene.triangles, scene.c2w, scene.fov, images, gbuffers, meta)))

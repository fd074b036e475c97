"""Scenes of the picture benchmarks, each seen by its first camera."""

from __future__ import annotations

import numpy as np

from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.shards.job import SceneSource


def stored(path: str) -> PackedScene:
    """Load a scene from a file. Raises SceneError."""
    return pack(load_scene(path)).views([0])


def sampled(family: SceneSource, seed: int) -> PackedScene:
    """Draw a test scene of a family."""
    rngs = (np.random.default_rng([seed, stream]) for stream in range(2))
    return pack(family.sample(*rngs, held_out=True)).views([0])

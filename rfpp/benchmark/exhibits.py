"""Scenes of the picture benchmarks, from files or sampled from families. Each is seen by its first camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.shards.job import SceneSource


@dataclass(frozen=True)
class SceneFile:
    """Scene of a file.

    Attributes:
        title: Name in tables and pictures.
        path: File that `load_scene` reads.
    """

    title: str
    path: str

    def scene(self) -> PackedScene:
        """Load the scene. Raises SceneError."""
        return pack(load_scene(self.path)).views([0])


@dataclass(frozen=True)
class SampledScene:
    """Test scene of a family.

    Attributes:
        title: Name in tables and pictures.
        family: Family of the scene.
        seed: Seed of the draw.
    """

    title: str
    family: SceneSource
    seed: int

    def scene(self) -> PackedScene:
        """Draw the scene."""
        rngs = (np.random.default_rng([self.seed, stream]) for stream in range(2))
        return pack(self.family.sample(*rngs, held_out=True)).views([0])

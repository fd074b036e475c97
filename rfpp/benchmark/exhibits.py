"""Scenes of the picture benchmarks, from files or sampled from families."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import SupportsFloat

import numpy as np

from rfpp.errors import UserError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.shards.job import SceneSource


@dataclass(frozen=True)
class SceneFile:
    """A scene file, seen by one of its cameras.

    Attributes:
        title: what the gallery calls it.
        path: what `load_scene` reads.
        camera: number of one of its cameras.
        moved: name of an object → its translation, where it is another than in the file.
    """

    title: str
    path: Path | str
    camera: int = 0
    moved: Mapping[str, Sequence[SupportsFloat]] = field(default_factory=dict)

    def scene(self) -> PackedScene:
        """Raises UserError: `moved` names no object of the file; SceneError: see `load_scene`."""
        scene = load_scene(self.path)
        if unknown := set(self.moved) - {item.name for item in scene.objects}:
            raise UserError(f"{self.path}: has no object '{min(unknown)}' to move: correct the gallery's `moved`")
        objects = tuple(
            item
            if item.name not in self.moved
            else item.model_copy(
                update={"transform": item.transform.model_copy(update={"translation": tuple(self.moved[item.name])})}
            )
            for item in scene.objects
        )
        return pack(scene.model_copy(update={"objects": objects})).views([self.camera])


@dataclass(frozen=True)
class SampledScene:
    """A test scene of a family.

    Attributes:
        title: what the gallery calls it.
        family: where it is drawn.
        seed: of the draw.
    """

    title: str
    family: SceneSource
    seed: int

    def scene(self) -> PackedScene:
        """Seen by its first camera."""
        rngs = (np.random.default_rng([self.seed, stream]) for stream in range(2))
        return pack(self.family.sample(*rngs, held_out=True)).views([0])

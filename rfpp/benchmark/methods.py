"""Scenes of the picture benchmarks; timed rendering with a `Renderer` and with Cycles, and the errors of the images.

Both methods take sequences of scenes and return (images, seconds) of each scene, after warming up. The scenes of a
sequence are versions of one scene, between which a renderer may reuse its caches.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from jaxtyping import Float

from rfpp.inference.references import Traced, path_traced
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flip import flip
from rfpp.metrics.image import log_l1, ssim
from rfpp.reference.cycles import CyclesSettings
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


@dataclass(frozen=True)
class ByRenderer:
    """Rendering with a renderer of this project."""

    checkpoint: str
    sampling: Mapping[str, int]

    def __call__(self, sequences: Sequence[Sequence[PackedScene]], resolution: int) -> list[list[Traced]]:
        loaded, results = Renderer.load(self.checkpoint), []
        loaded.render(sequences[-1][0].views([0]), resolution, **self.sampling)  # warms up
        for sequence in sequences:
            renderer, traced = loaded.fresh(), []  # its caches hold nothing of other scenes
            for scene in sequence:
                begin = time.perf_counter()
                images = renderer.render(scene, resolution, **self.sampling)
                traced.append((images, time.perf_counter() - begin))
            results.append(traced)
        return results


@dataclass(frozen=True)
class ByCycles:
    """Rendering with Cycles in one process, which has no caches."""

    settings: CyclesSettings

    def __call__(self, sequences: Sequence[Sequence[PackedScene]], resolution: int) -> list[list[Traced]]:
        scenes = [sequences[-1][0].views([0]), *chain(*sequences)]
        traced = path_traced(scenes, (resolution, resolution), self.settings)
        next(traced)  # warms up
        return [[next(traced) for _ in sequence] for sequence in sequences]


def errors(image: Float[np.ndarray, "h w 3"], reference: Float[np.ndarray, "h w 3"]) -> dict[str, float]:
    """Return log-L1, ꟻLIP and SSIM of linear radiance."""
    x, y = (torch.from_numpy(np.ascontiguousarray(one)).permute(2, 0, 1)[None] for one in (image, reference))
    return {"log_l1": float(log_l1(x, y)), "flip": float(flip(image, reference).mean()), "ssim": float(ssim(x, y))}

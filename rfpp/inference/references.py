"""Path-traced images of scenes, rendered in a worker process, which imports this file and so must not load torch."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np
from jaxtyping import Float

from rfpp.reference.cycles import CyclesSettings, render
from rfpp.reference.farm import RenderFarm
from rfpp.scene.packed import PackedScene

Traced = tuple[Float[np.ndarray, "v h w 3"], float]


def path_traced(scenes: Iterable[PackedScene], size: tuple[int, int], settings: CyclesSettings) -> Iterator[Traced]:
    """Yield for each scene, in order, the linear radiance seen by its cameras and the render time in seconds.

    Scenes are read one at a time; `size` is (height, width) in pixels. Raises UserError if Blender is missing or cannot
    render a scene.
    """
    with RenderFarm(1) as farm:
        for _, traced in farm.map(partial(_trace, size=size, settings=settings), scenes):
            if isinstance(traced, Exception):
                raise traced
            yield traced


def _trace(scene: PackedScene, size: tuple[int, int], settings: CyclesSettings) -> Traced:
    begin = time.perf_counter()
    images = render(scene.triangles, scene.c2w, scene.fov, *size, settings)
    return images, time.perf_counter() - begin

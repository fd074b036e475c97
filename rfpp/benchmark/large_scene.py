"""Time and peak memory of rendering a large scene, in a fresh process."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from rfpp.benchmark.editing import moved, renderer, setting_columns, timed
from rfpp.benchmark.memory import peak_resident
from rfpp.benchmark.spheres import spheres
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import pack

Row = dict[str, str | int | float | None]


def measure(
    network: RenderFormerPP,
    triangles: int,
    objects: int,
    resolution: int,
    seed: int,
    device: str,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """A row per step: packing the scene's triangles, rendering it, rendering it again with one object moved.

    `peak_GB` is the resident memory that this process, with its libraries, weights and scene, has taken at most until
    the step was done.

    Args:
        network: untrained ones cost the same.
        triangles, objects: of the scene.
        resolution: pixels along both sides of the one view.
        seed: of the scene.
        device: where to render.
        progress: called with (steps done, steps in all).
    """
    remembering = renderer(network, resolution, device)
    scene = spheres(triangles, objects, views=1, seed=seed)
    edited = pack(moved(scene, np.random.default_rng(seed)))
    steps: dict[str, Callable[[], object]] = {
        "triangles packed": partial(pack, scene),
        "rendered": partial(remembering.render, pack(scene)),
        "rendered with an object moved": partial(remembering.render, edited),
    }
    rows = []
    for number, (name, step) in enumerate(steps.items(), start=1):
        _, seconds = timed(step)
        rows.append(
            {
                "step": name,
                **setting_columns(network, triangles, objects, resolution, device),
                "seconds": seconds,
                "peak_GB": peak_resident() / 1e9,
            }
        )
        progress(number, len(steps))
    return rows

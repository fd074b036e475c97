"""How large a scene may be: time and peak memory of rendering one, in a process that has done nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from rfpp.benchmark.editing import moved, renderer, timed
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
    """One row: seconds to make the scene, to render it, and to render it again with one object moved.

    `peak_GB` is the resident memory that this process, with its libraries, weights and scene, has taken at most.

    Args:
        network: untrained ones cost the same.
        triangles, objects: of the scene.
        resolution: pixels along both sides of the one view.
        seed: of the scene.
        device: where to render.
        progress: called with (steps done, steps in all).
    """
    scene, scene_seconds = timed(lambda: pack(spheres(triangles, objects, views=1, seed=seed)))
    progress(1, 3)
    remembering = renderer(network, resolution, device)
    _, render_seconds = timed(lambda: remembering.render(scene))
    progress(2, 3)
    edited = pack(moved(spheres(triangles, objects, views=1, seed=seed), np.random.default_rng(seed)))
    _, moved_seconds = timed(lambda: remembering.render(edited))
    progress(3, 3)
    return [
        {
            "triangles": len(scene.triangles),
            "objects": scene.triangles.num_objects,
            "resolution": resolution,
            "parameters_M": sum(p.numel() for p in network.parameters()) / 1e6,
            "device": device,
            "threads": torch.get_num_threads(),
            "scene_s": scene_seconds,
            "render_s": render_seconds,
            "object_moved_s": moved_seconds,
            "peak_GB": peak_resident() / 1e9,
        }
    ]

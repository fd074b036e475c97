"""Cost of re-rendering after an edit, with and without the renderer's caches."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import TypeVar

import numpy as np
import torch

from rfpp.benchmark.spheres import LAMP, camera, spheres
from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.inference.renderer import Renderer
from rfpp.model.layers.matrix_precision import matrix_dtype
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import pack
from rfpp.scene.spec import Scene

Row = dict[str, str | int | float | None]
Result = TypeVar("Result")


def measure(
    network: RenderFormerPP,
    triangles: int,
    objects: int,
    resolution: int,
    rounds: int,
    seed: int,
    device: str,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """A row per edit: seconds from triangles to image, both ways, and the largest difference between the images.

    Both take turns. Times are medians over rounds, each with an edit that has not been seen before.

    Args:
        network: with object tokens; untrained ones cost the same.
        triangles, objects: of the scene.
        resolution: pixels along both sides of the one view.
        rounds: how often each edit is made.
        seed: of scene and edits.
        device: where to render.
        progress: called with (edits made, edits in all).
    """
    rng = np.random.default_rng(seed)
    scene = spheres(triangles, objects, views=1, seed=seed)
    known = renderer(network, resolution, device)
    known.render(scene)
    rows = []
    for number, (name, edit) in enumerate(EDITS.items()):
        anew, remembered, differences = [], [], []
        for turn in range(rounds):
            edited = pack(edit(scene, rng))
            encoded = known.objects.encoded
            image, seconds = timed(partial(known.render, edited))
            remembered.append(seconds)
            encoded = known.objects.encoded - encoded
            expected, seconds = timed(partial(renderer(network, resolution, device).render, edited))
            anew.append(seconds)
            differences.append(float(np.abs(image - expected).max()))
            progress(number * rounds + turn + 1, len(EDITS) * rounds)
        rows.append(
            {
                "edit": name,
                **setting_columns(network, triangles, objects, resolution, device),
                "objects_encoded": encoded,
                "anew_s": median(anew),
                "remembered_s": median(remembered),
                "speedup": median(anew) / median(remembered),
                "max_difference": max(differences),
            }
        )
    return rows


def setting_columns(network: RenderFormerPP, triangles: int, objects: int, resolution: int, device: str) -> Row:
    """What was rendered, and on what."""
    return {
        "triangles": triangles,
        "objects": objects,
        "resolution": resolution,
        "parameters_M": sum(p.numel() for p in network.parameters()) / 1e6,
        "device": device,
        "precision": str(_dtype(device)).removeprefix("torch."),
        "threads": torch.get_num_threads(),
    }


def renderer(network: RenderFormerPP, resolution: int, device: str) -> Renderer:
    """One that remembers nothing yet, of an untrained network."""
    about = {"data_manifest": "none", "dataset": "none", "method": "untrained", "seed": 0, "steps": 0}
    return Renderer(network, CheckpointInfo({}, (resolution, resolution), **about), device, _dtype(device))


def _dtype(device: str) -> torch.dtype:
    """As renderers choose by themselves."""
    return matrix_dtype("auto", torch.device(device))


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """What a call returns, and the seconds it took."""
    begin = time.perf_counter()
    result = call()
    return result, time.perf_counter() - begin


def _with(scene: Scene, name: str, **parts: object) -> Scene:
    objects = tuple(o.model_copy(update=parts) if o.name == name else o for o in scene.objects)
    return scene.model_copy(update={"objects": objects})


def moved(scene: Scene, rng: np.random.Generator) -> Scene:
    """An object elsewhere."""
    item = scene.objects[0]
    place = tuple(rng.uniform(-0.4, 0.4, 3).tolist())
    return _with(scene, item.name, transform=item.transform.model_copy(update={"translation": place}))


def recoloured(scene: Scene, rng: np.random.Generator) -> Scene:
    """An object of another colour."""
    item = scene.objects[0]
    colour = tuple(rng.uniform(0.1, 0.7, 3).tolist())
    return _with(scene, item.name, material=item.material.model_copy(update={"diffuse": colour}))


def dimmed(scene: Scene, rng: np.random.Generator) -> Scene:
    """A lamp of another power."""
    [lamp] = (item for item in scene.objects if item.name == LAMP)
    power = (float(rng.uniform(1, 15)),) * 3
    return _with(scene, LAMP, material=lamp.material.model_copy(update={"emissive": power}))


def turned(scene: Scene, rng: np.random.Generator) -> Scene:
    """A camera elsewhere."""
    return scene.model_copy(update={"cameras": (camera(float(rng.uniform(0.1, 0.9))),)})


EDITS: dict[str, Callable[[Scene, np.random.Generator], Scene]] = {
    "none": lambda scene, rng: scene,
    "object moved": moved,
    "object recoloured": recoloured,
    "light dimmed": dimmed,
    "camera moved": turned,
}

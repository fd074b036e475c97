"""Cost and error of each reference preset."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from rfpp.errors import UserError
from rfpp.metrics.image import log_l1, mape
from rfpp.reference import cycles
from rfpp.reference.cycles import CyclesSettings
from rfpp.reference.farm import RenderFarm
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.sampling.family import SceneFamily

Row = dict[str, str | int | float]

_CONVERGED, _CONVERGED_AGAIN = "converged", "converged, other seed"


@dataclass(frozen=True)
class TimedRender:
    """Renders one view of a scene in a worker process; returns image [H, W, 3], wall and CPU seconds."""

    resolution: int

    def __call__(self, task: tuple[str, PackedScene, CyclesSettings]) -> tuple[np.ndarray, float, float]:
        _, scene, settings = task
        wall, cpu = time.perf_counter(), time.process_time()
        [image] = cycles.render(scene.triangles, scene.c2w, scene.fov, self.resolution, self.resolution, settings)
        return image, time.perf_counter() - wall, time.process_time() - cpu


def measure(
    families: Mapping[str, SceneFamily],
    settings: Mapping[str, CyclesSettings],
    converged: CyclesSettings,
    scenes: int,
    resolution: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """One row per family and setting: time per image, and error against the converged image, means over the scenes.

    The last row of each family renders the converged image again with another seed: an error below it cannot be
    told from noise. Errors are relative L1 (Σ|x - y| / Σy), MAPE and log-L1 of `rfpp.metrics.image`, and brightness
    is Σx / Σy.

    Args:
        families, settings: by name.
        converged: undenoised, of many samples, otherwise as the settings.
        scenes: of each family; the first view of each is rendered.
        resolution: pixels.
        seed: of the scenes.
        progress: called with (images rendered, images in all).

    Raises:
        UserError: a render failed.
    """
    again = CyclesSettings(**{**vars(converged), "seed": converged.seed + 1})
    all_settings = {_CONVERGED: converged, **settings, _CONVERGED_AGAIN: again}
    tasks = [
        (name, scene, setting)
        for name, family in families.items()
        for scene in _scenes(family, scenes, seed)
        for setting in all_settings.values()
    ]
    results = []
    with RenderFarm(workers=1) as farm:  # one at a time on all cores: times that can be compared
        for (name, scene, _), result in farm.map(TimedRender(resolution), tasks, attempts=1):
            if isinstance(result, Exception):
                raise UserError(f"{name}: {scene.name}: Cycles failed: {result}")
            results.append(result)
            progress(len(results), len(tasks))
    rows = []
    per_family = scenes * len(all_settings)
    for index, name in enumerate(families):
        mine = results[index * per_family : (index + 1) * per_family]
        triangles = np.mean([len(scene.triangles) for of, scene, _ in tasks if of == name])
        for place, (setting, values) in enumerate(all_settings.items()):
            if place:
                of_setting, references = mine[place :: len(all_settings)], mine[:: len(all_settings)]
                row = {"family": name, "triangles": round(triangles), "resolution": resolution, "images": scenes}
                rows.append({**row, "setting": setting, "samples": values.samples, **_means(of_setting, references)})
    return rows


def _scenes(family: SceneFamily, count: int, seed: int) -> Iterator[PackedScene]:
    for index in range(count):
        rngs = (np.random.default_rng([seed, index, stream]) for stream in range(2))
        yield pack(family.sample(*rngs, held_out=False)).views([0])


def _means(results: list[tuple], references: list[tuple]) -> Row:
    x, y = (
        torch.stack([torch.from_numpy(image) for image, *_ in of]).permute(0, 3, 1, 2) for of in (results, references)
    )
    values = {
        "wall_seconds": torch.tensor([wall for _, wall, _ in results]),
        "cpu_seconds": torch.tensor([cpu for *_, cpu in results]),
        "relative_l1": (x - y).abs().flatten(1).sum(1) / y.flatten(1).sum(1),
        "mape": mape(x, y),
        "log_l1": log_l1(x, y),
        "brightness": x.flatten(1).sum(1) / y.flatten(1).sum(1),
    }
    return {name: value.mean().item() for name, value in values.items()}

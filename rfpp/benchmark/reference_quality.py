"""Measure time and error of each reference preset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import torch

from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.methods import ByCycles
from rfpp.inference.references import Traced
from rfpp.metrics.image import log_l1, mape
from rfpp.ranges import Positive
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import pack
from rfpp.shards.job import SceneSource


def measure(
    families: Mapping[str, SceneSource],
    settings: Mapping[str, CyclesSettings],
    converged: CyclesSettings,
    scenes: Positive,
    resolution: Positive,
    seed: int,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per family and preset: seconds per image and error against the converged image, means over scenes.

    The last row of each family renders the converged image with another seed; smaller errors are noise. Errors are
    relative L1 (Σ|x - y| / Σy), MAPE and log-L1 of `rfpp.metrics.image`; brightness is Σx / Σy.
    """
    compared = {**settings, "converged, other seed": replace(converged, seed=converged.seed + 1)}
    done, total = 0, len(families) * (1 + len(compared)) * scenes
    for family_name, family in families.items():
        packed = []
        for index in range(scenes):
            rngs = (np.random.default_rng([seed, index, stream]) for stream in range(2))
            packed.append(pack(family.sample(*rngs, held_out=False)).views([0]))
        references = None
        for name, preset in {"converged": converged, **compared}.items():
            rendered = [traced for [traced] in ByCycles(preset)([[scene] for scene in packed], resolution)]
            done += scenes
            progress(done, total)
            if references is None:
                references = rendered
                continue
            yield {
                "family": family_name,
                "triangles": round(np.mean([len(scene.triangles) for scene in packed])),
                "resolution": resolution,
                "images": scenes,
                "setting": name,
                "samples": preset.samples,
                **_means(rendered, references),
            }


def _means(rendered: list[Traced], references: list[Traced]) -> Row:
    both = (np.concatenate([images for images, _ in traced]) for traced in (rendered, references))
    x, y = (torch.from_numpy(images).permute(0, 3, 1, 2) for images in both)
    brightness = y.flatten(1).sum(1)
    return {
        "seconds": float(np.mean([seconds for _, seconds in rendered])),
        "relative_l1": ((x - y).abs().flatten(1).sum(1) / brightness).mean().item(),
        "mape": mape(x, y).mean().item(),
        "log_l1": log_l1(x, y).mean().item(),
        "brightness": (x.flatten(1).sum(1) / brightness).mean().item(),
    }

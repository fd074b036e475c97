"""Render a gallery: models beside Cycles, converged and in the same time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.methods import ByCycles, ByRenderer, errors
from rfpp.imaging.panels import Picture, error_map, panel, save_picture, tone_mapped
from rfpp.ranges import Positive
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene


def measure(
    checkpoints: Sequence[str],
    exhibits: Mapping[str, PackedScene],
    resolution: Positive,
    reference: CyclesSettings,
    cycles: CyclesSettings,
    samples: Sequence[Positive],
    picture: str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per scene and checkpoint with seconds and errors of both; then save a sheet of all images.

    All methods are warm, have not rendered the scene before, and run alone. A renderer's time includes ray casting;
    the time of Cycles includes building the scene. The sheet shows Cycles in the time of the last checkpoint.
    """
    names = {checkpoint: Path(checkpoint).name for checkpoint in checkpoints}
    scenes = [[scene] for scene in exhibits.values()]
    methods: dict[str | int, ByRenderer | ByCycles] = {one: ByRenderer(one, {}) for one in checkpoints}
    methods |= {"reference": ByCycles(reference)}
    methods |= {count: ByCycles(replace(cycles, samples=count)) for count in samples}
    results: dict[str | int, list[tuple[np.ndarray, float]]] = {}
    for number, (key, method) in enumerate(methods.items(), start=1):
        results[key] = [(images[0], seconds) for [(images, seconds)] in method(scenes, resolution)]
        progress(number * len(scenes), len(methods) * len(scenes))
    columns: dict[str, list[Picture]] = {}
    captions = []
    for place, (title, scene) in enumerate(exhibits.items()):
        truth, reference_s = results["reference"][place]
        tiles = {"Cycles converged": tone_mapped(truth)}
        for checkpoint, name in names.items():
            image, seconds = results[checkpoint][place]
            count = affordable({count: results[count][place][1] for count in samples}, seconds)
            traced, cycles_s = results[count][place]
            own, theirs = errors(image, truth), errors(traced, truth)
            yield {
                "scene": title,
                "triangles": len(scene.triangles),
                "objects": scene.triangles.num_objects,
                "resolution": resolution,
                "method": name,
                "seconds": seconds,
                **own,
                "cycles_samples": count,
                "cycles_s": cycles_s,
                **{f"cycles_{metric}": error for metric, error in theirs.items()},
                "reference_samples": reference.samples,
                "reference_s": reference_s,
            }
            tiles |= {name: tone_mapped(image), f"error of {name}": error_map(image, truth)}
        tiles |= {"Cycles in the same time": tone_mapped(traced), "error of Cycles": error_map(traced, truth)}
        for heading, tile in tiles.items():
            columns.setdefault(heading, []).append(tile)
        captions.append(
            f"{title}: Cycles {reference_s:.1f} s for {reference.samples} samples; {name} {seconds:.2f} s, FLIP "
            f"{own['flip']:.3f}; Cycles {cycles_s:.2f} s for {count} spp, FLIP {theirs['flip']:.3f}"
        )
    save_picture(panel(columns, captions), Path(picture))


def affordable(seconds: Mapping[int, float], limit: float) -> int:
    """Return the largest sample count that takes at most `limit` seconds, else the smallest one."""
    return max((samples for samples, took in seconds.items() if took <= limit), default=min(seconds))

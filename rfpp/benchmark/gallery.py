"""Render a gallery: a renderer beside Cycles, converged and in the same time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.methods import ByCycles, ByRenderer, errors
from rfpp.imaging.panels import Picture, error_map, panel, save_picture, tone_mapped
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene


def measure(
    checkpoint: str,
    exhibits: Mapping[str, PackedScene],
    resolution: int,
    reference: CyclesSettings,
    cycles: CyclesSettings,
    samples: Sequence[int],
    picture: str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per scene with seconds and errors of both; then save a sheet of all images.

    All methods are warm, have not rendered the scene before, and run alone. The renderer's time includes ray casting;
    the time of Cycles includes building the scene.
    """
    name = Path(checkpoint).name
    scenes = [[scene] for scene in exhibits.values()]
    methods = {"renderer": ByRenderer(checkpoint, {}), "reference": ByCycles(reference)}
    methods |= {count: ByCycles(replace(cycles, samples=count)) for count in samples}
    results = {}
    for number, (key, method) in enumerate(methods.items(), start=1):
        results[key] = [(images[0], seconds) for [(images, seconds)] in method(scenes, resolution)]
        progress(number * len(scenes), len(methods) * len(scenes))
    headings = ("Cycles converged", name, f"error of {name}", "Cycles in the same time", "error of Cycles")
    columns: dict[str, list[Picture]] = {heading: [] for heading in headings}
    captions = []
    for place, (title, scene) in enumerate(exhibits.items()):
        (image, seconds), (truth, reference_s) = results["renderer"][place], results["reference"][place]
        count = affordable({count: results[count][place][1] for count in samples}, seconds)
        traced, cycles_s = results[count][place]
        row = {
            "scene": title,
            "triangles": len(scene.triangles),
            "objects": scene.triangles.num_objects,
            "resolution": resolution,
            "method": name,
            "seconds": seconds,
            **errors(image, truth),
            "cycles_samples": count,
            "cycles_s": cycles_s,
            **{f"cycles_{metric}": error for metric, error in errors(traced, truth).items()},
            "reference_samples": reference.samples,
            "reference_s": reference_s,
        }
        tiles = [tone_mapped(truth)]
        for compared in (image, traced):
            tiles += [tone_mapped(compared), error_map(compared, truth)]
        for heading, tile in zip(headings, tiles, strict=True):
            columns[heading].append(tile)
        captions.append(
            "{scene}: Cycles {reference_s:.1f} s for {reference_samples} samples; {method} {seconds:.2f} s, FLIP "
            "{flip:.3f}; Cycles {cycles_s:.2f} s for {cycles_samples} spp, FLIP {cycles_flip:.3f}".format(**row)
        )
        yield row
    save_picture(panel(columns, captions), Path(picture))


def affordable(seconds: Mapping[int, float], limit: float) -> int:
    """Return the largest sample count that takes at most `limit` seconds, else the smallest one."""
    return max((samples for samples, took in seconds.items() if took <= limit), default=min(seconds))

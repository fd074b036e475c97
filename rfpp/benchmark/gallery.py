"""A gallery of a trained network's pictures beside Cycles, with render times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from rfpp.benchmark.exhibits import SampledScene, SceneFile
from rfpp.imaging.panels import error_map, panel, save_png, tone_mapped
from rfpp.inference.references import path_traced
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flip import flip
from rfpp.metrics.image import log_l1
from rfpp.reference.cycles import CyclesSettings

Row = dict[str, str | int | float]


def measure(
    checkpoint: str,
    exhibits: Sequence[SceneFile | SampledScene],
    resolution: int,
    reference: CyclesSettings,
    picture: Path | str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per exhibit: seconds of network and Cycles, log-L1 and ꟻLIP; at the end, a sheet of all of them.

    The network's time is that of a scene that it has not seen before: rays, encoding and decoding, after one picture
    of another scene to wake it up.

    Args:
        checkpoint: see `rfpp.checkpoint.loading.load_network`.
        resolution: pixels.
        reference: how Cycles renders.
        picture: PNG file to write.
        progress: called with (pictures made, pictures in all).
    """
    renderer, scenes = Renderer.load(checkpoint), [exhibit.scene() for exhibit in exhibits]
    renderer.render(scenes[-1], resolution)
    columns: dict[str, list] = {"path-traced": [], "network": [], "error": []}
    captions = []
    for number, (exhibit, scene, (truth, seconds)) in enumerate(
        zip(exhibits, scenes, path_traced(scenes, (resolution, resolution), reference), strict=True)
    ):
        fresh = Renderer(renderer.network, renderer.info, renderer.device, renderer.dtype)
        begin = time.perf_counter()
        [image], [wanted] = fresh.render(scene, resolution), truth
        took = time.perf_counter() - begin
        row = {
            "scene": exhibit.title,
            "triangles": len(scene.triangles),
            "objects": scene.triangles.num_objects,
            "resolution": resolution,
            "network_s": took,
            "cycles_s": seconds,
            "cycles_samples": reference.samples,
            "log_l1": _log_l1(image, wanted),
            "flip": float(flip(image, wanted).mean()),
        }
        for column, shown in zip(
            columns.values(), (tone_mapped(wanted), tone_mapped(image), error_map(image, wanted)), strict=True
        ):
            column.append(shown)
        captions.append(f"{row['scene']}: Cycles {seconds:.1f} s, network {took:.1f} s, FLIP {row['flip']:.3f}")
        progress(number + 1, len(exhibits))
        yield row
    save_png(panel(columns, captions), Path(picture))


def _log_l1(image: np.ndarray, reference: np.ndarray) -> float:
    x, y = (torch.from_numpy(np.ascontiguousarray(a)).permute(2, 0, 1)[None] for a in (image, reference))
    return float(log_l1(x, y))

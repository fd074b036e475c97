"""A gallery of a trained network's pictures beside Cycles: converged, and with as few samples as take the same time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rfpp.benchmark.equal_time import errors
from rfpp.benchmark.exhibits import SampledScene, SceneFile
from rfpp.imaging.panels import Picture, error_map, panel, save_picture, tone_mapped
from rfpp.inference.references import Traced, path_traced
from rfpp.inference.renderer import Renderer
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene

Row = dict[str, str | int | float]


def measure(
    checkpoint: str,
    exhibits: Sequence[SceneFile | SampledScene],
    resolution: int,
    reference: CyclesSettings,
    rival: CyclesSettings,
    rival_samples: Sequence[int],
    picture: Path | str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per exhibit: seconds and errors of the network and of its rival; at the end, a sheet of all of them.

    All are timed on scenes that they have not seen before, after one picture that wakes them up, while nothing else
    renders: of the network, rays, encoding and decoding; of Cycles, all that it does with a scene.

    Args:
        checkpoint: see `rfpp.checkpoint.loading.load_network`.
        resolution: pixels.
        reference: how Cycles renders what both are compared with; not by the rival's denoiser, whose errors it would
            share.
        rival: Cycles' settings but for the samples.
        rival_samples: among which `in_the_time` chooses.
        picture: PNG or JPEG file to write.
        progress: called with (pictures made, pictures in all).
    """
    scenes = [exhibit.scene() for exhibit in exhibits]
    total = len(scenes) * (len(rival_samples) + 2)
    by_network = _by_network(Renderer.load(checkpoint), scenes, resolution)
    progress(len(scenes), total)
    by_rivals: dict[int, list[Traced]] = {}
    for samples in rival_samples:
        by_rivals[samples] = list(_by_cycles(scenes, resolution, replace(rival, samples=samples)))
        progress(len(scenes) * (len(by_rivals) + 1), total)
    headings = ("Cycles converged", "network", "error of network", "Cycles in the same time", "error of Cycles")
    columns: dict[str, list[Picture]] = {heading: [] for heading in headings}
    captions = []
    for number, ([truth], cycles_s) in enumerate(_by_cycles(scenes, resolution, reference)):
        [image], network_s = by_network[number]
        samples = in_the_time({count: made[number][1] for count, made in by_rivals.items()}, network_s)
        [traced], rival_s = by_rivals[samples][number]
        row = {
            "scene": exhibits[number].title,
            "triangles": len(scenes[number].triangles),
            "objects": scenes[number].triangles.num_objects,
            "resolution": resolution,
            "network_s": network_s,
            "cycles_s": cycles_s,
            "cycles_samples": reference.samples,
            **errors(image, truth),
            "rival_samples": samples,
            "rival_s": rival_s,
            **{f"rival_{name}": error for name, error in errors(traced, truth).items()},
        }
        shown = [tone_mapped(truth)]
        for made in (image, traced):
            shown += [tone_mapped(made), error_map(made, truth)]
        for heading, one in zip(headings, shown, strict=True):
            columns[heading].append(one)
        captions.append(_caption(row))
        progress(total - len(scenes) + number + 1, total)
        yield row
    save_picture(panel(columns, captions), Path(picture))


def in_the_time(seconds: Mapping[int, float], limit: float) -> int:
    """The largest number of samples that takes no longer than the limit; the smallest if all of them do.

    Args:
        seconds: number of samples → what a picture of them takes.
        limit: seconds.
    """
    return max((samples for samples, took in seconds.items() if took <= limit), default=min(seconds))


def _by_network(renderer: Renderer, scenes: Sequence[PackedScene], resolution: int) -> list[Traced]:
    """The picture of each scene, by a renderer that has seen nothing yet, and its seconds."""
    renderer.render(scenes[-1], resolution)
    made = []
    for scene in scenes:
        fresh = Renderer(renderer.network, renderer.info, renderer.device, renderer.dtype)
        begin = time.perf_counter()
        made.append((fresh.render(scene, resolution), time.perf_counter() - begin))
    return made


def _by_cycles(scenes: Sequence[PackedScene], resolution: int, settings: CyclesSettings) -> Iterator[Traced]:
    """The picture of each scene, by a process that is awake, and its seconds."""
    traced = path_traced([scenes[-1], *scenes], (resolution, resolution), settings)
    next(traced)
    yield from traced


def _caption(row: Row) -> str:
    return (
        f"{row['scene']}: Cycles {row['cycles_s']:.1f} s for {row['cycles_samples']} samples; network "
        f"{row['network_s']:.2f} s, FLIP {row['flip']:.3f}; Cycles {row['rival_s']:.2f} s for "
        f"{row['rival_samples']} sample{'s' * (row['rival_samples'] != 1)}, FLIP {row['rival_flip']:.3f}"
    )

"""A trained network's pictures of chosen scenes beside Cycles', with the time of each: what it can do and what not."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import SupportsFloat

import numpy as np
import torch

from rfpp.errors import UserError
from rfpp.inference.references import path_traced
from rfpp.inference.renderer import Renderer
from rfpp.metrics.flip import flip
from rfpp.metrics.image import log_l1
from rfpp.panels import error_map, panel, save_png, tone_mapped
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene
from rfpp.shards.job import SceneSource

Row = dict[str, str | int | float]


@dataclass(frozen=True)
class Stored:
    """A scene file, seen by one of its cameras.

    Attributes:
        title: what the gallery calls it.
        path: what `Scene.load` reads.
        camera: number of one of its cameras.
        moved: name of an object → its translation, where it is another than in the file.
    """

    title: str
    path: Path | str
    camera: int = 0
    moved: Mapping[str, Sequence[SupportsFloat]] = field(default_factory=dict)

    def scene(self) -> PackedScene:
        """Raises UserError: `moved` names no object of the file; SceneError: see `Scene.load`."""
        scene = Scene.load(self.path)
        if unknown := set(self.moved) - {item.name for item in scene.objects}:
            raise UserError(f"{self.path}: has no object '{min(unknown)}' to move: correct the gallery's `moved`")
        objects = tuple(
            item
            if item.name not in self.moved
            else item.model_copy(
                update={"transform": item.transform.model_copy(update={"translation": tuple(self.moved[item.name])})}
            )
            for item in scene.objects
        )
        return pack(scene.model_copy(update={"objects": objects})).views([self.camera])


@dataclass(frozen=True)
class Drawn:
    """A test scene of a family.

    Attributes:
        title: what the gallery calls it.
        family: where it is drawn.
        seed: of the draw.
    """

    title: str
    family: SceneSource
    seed: int

    def scene(self) -> PackedScene:
        """Seen by its first camera."""
        rngs = (np.random.default_rng([self.seed, stream]) for stream in range(2))
        return pack(self.family.sample(*rngs, held_out=True)).views([0])


def measure(
    checkpoint: str,
    exhibits: Sequence[Stored | Drawn],
    resolution: int,
    reference: CyclesSettings,
    picture: Path | str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per exhibit: seconds of network and Cycles, log-L1 and ꟻLIP; at the end, a sheet of all of them.

    The network's time is that of a scene that it has not seen before: rays, encoding and decoding, after one picture
    of another scene to wake it up.

    Args:
        checkpoint: see `rfpp.inference.checkpoint.load_network`.
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

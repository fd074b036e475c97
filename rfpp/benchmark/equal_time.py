"""Compare a renderer with Cycles at few samples, denoised: time, error and flicker."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from statistics import median

import numpy as np
from jaxtyping import Float

from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.methods import ByCycles, ByRenderer, errors
from rfpp.files import write_atomically
from rfpp.inference.references import Traced
from rfpp.metrics.flicker import flicker
from rfpp.ranges import Positive
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import EMISSION

#: Degrees about the vertical axis from a view to the next one, and from the first frame of an animation to the last.
_NEXT_VIEW, _ARC = 5.0, 12.0


def measure(
    checkpoint: str,
    exhibits: Mapping[str, PackedScene],
    resolution: Positive,
    samplings: Sequence[Mapping[str, int]],
    samples: Sequence[Positive],
    rounds: Positive,
    cycles: CyclesSettings,
    converged: CyclesSettings,
    animation: Mapping[str, int] | None,
    cache: str,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per scene and method: seconds, errors of the first image, flicker of an animation.

    All methods are warm and take turns. Seconds are medians over the rounds: of the first image of a scene (`first_s`),
    of another view (`view_s`) and of the scene with one light source dimmed (`edit_s`).

    Args:
        animation: `frames` on an arc around each scene, their `resolution`, and `samples` of the references; or None.
    """
    scenes = list(exhibits.values())
    references = [_reference(scene, resolution, converged, Path(cache))[0] for scene in scenes]
    name = Path(checkpoint).name
    methods: dict[str, tuple[ByRenderer | ByCycles, Row]] = {
        f"{name} {s['light_samples']} of {s['supersampling'] ** 2}": (ByRenderer(checkpoint, s), {"samples": None, **s})
        for s in samplings
    }
    methods |= {f"Cycles {n}": (ByCycles(replace(cycles, samples=n)), {"samples": n}) for n in samples}
    versions = [[scene, orbit(scene, [_NEXT_VIEW]), dimmed(scene)] for scene in scenes]
    results: dict[str, list[list[list[Traced]]]] = {name: [] for name in methods}
    turns = [name for _ in range(rounds) for name in methods]
    total = len(turns) + len(methods)
    for taken, name in enumerate(turns, start=1):
        results[name].append(methods[name][0](versions, resolution))
        progress(taken, total)
    arcs, arc_references = [], []
    if animation:
        arcs = [[orbit(scene, np.linspace(0, _ARC, animation["frames"]))] for scene in scenes]
        settings = replace(converged, samples=animation["samples"])
        arc_references = [_reference(arc, animation["resolution"], settings, Path(cache)) for [arc] in arcs]
    for taken, (name, (method, columns)) in enumerate(methods.items(), start=len(turns) + 1):
        rows: list[Row] = []
        for place, (title, reference) in enumerate(zip(exhibits, references, strict=True)):
            rounds_of_scene = [turn[place] for turn in results[name]]
            first, view, edit = (median(s for _, s in traced) for traced in zip(*rounds_of_scene, strict=True))
            [(images, _), *_] = rounds_of_scene[0]
            row: Row = {"scene": title, "method": name, **columns, "resolution": resolution}
            rows.append({**row, "first_s": first, "view_s": view, "edit_s": edit, **errors(images[0], reference)})
        if animation:
            animations = method(arcs, animation["resolution"])
            for row, [(frames, seconds)], reference in zip(rows, animations, arc_references, strict=True):
                row |= {"frame_s": seconds / len(frames), "flicker": flicker(frames, reference)}
        yield from rows
        progress(taken, total)


def orbit(scene: PackedScene, degrees: Sequence[float] | np.ndarray) -> PackedScene:
    """Rotate the first camera about the vertical axis through the origin by each of these angles."""
    poses = []
    for angle in np.radians(degrees):
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        poses.append(turn @ scene.c2w[0])
    return replace(scene, c2w=np.stack(poses).astype(np.float32), fov=np.repeat(scene.fov[:1], len(poses)))


def dimmed(scene: PackedScene) -> PackedScene:
    """Halve the emission of the first emissive object."""
    triangles = scene.triangles
    material, light = triangles.material.copy(), triangles.object_index[triangles.is_emissive][0]
    material[triangles.object_index == light, EMISSION] *= 0.5
    return replace(scene, triangles=replace(triangles, material=material))


def _reference(
    scene: PackedScene, resolution: int, settings: CyclesSettings, folder: Path
) -> Float[np.ndarray, "v h w 3"]:
    digest = blake2b(f"{settings} {resolution}".encode(), digest_size=16)
    for array in (scene.triangles.positions, scene.triangles.normals, scene.triangles.material, scene.c2w, scene.fov):
        digest.update(np.ascontiguousarray(array))
    file = folder / f"{digest.hexdigest()}.npy"
    if not file.exists():
        [[(images, _)]] = ByCycles(settings)([[scene]], resolution)
        stream = io.BytesIO()
        np.save(stream, images)
        write_atomically(file, stream.getvalue())
    return np.load(file, allow_pickle=False)

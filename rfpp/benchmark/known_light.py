"""Cost and convergence of G-buffers with direct light and reflections."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import TypeVar

import numpy as np

from rfpp.raycast.first_hit import GBuffer, camera_caster, channel, first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.sampling.family import SceneFamily, TriangleBudget

Row = dict[str, str | int | float | None]
Result = TypeVar("Result")

#: Channel → the albedo it is multiplied with, which makes it radiance.
_LIGHT = {"direct_diffuse": "albedo", "direct_glossy": "specular", "reflected_light": "specular"}


@dataclass(frozen=True)
class Case:
    """Of what a G-buffer is made: pixels along a side, triangles of the scene, its lights, and samples."""

    resolution: int
    triangles: int
    lights: int
    samples: int


def measure(
    family: SceneFamily,
    case: Mapping[str, int],
    sweeps: Mapping[str, Sequence[int]],
    scenes: int,
    converged: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per value of each sweep: median seconds per image, and relative L1 from the converged light.

    Errors are means of |x - y| over means of y, of radiance, all images together; there are none where no other
    number of samples is compared.

    Args:
        family: of scenes; its triangles and lights are replaced by the case's.
        case: that the sweeps vary, see `Case`.
        sweeps: key of the case → values.
        scenes: of each row; one view of each is seen.
        converged: samples that count as all there is.
        seed: of scenes and samples.
        progress: called with (images made, images in all).
    """
    exact: dict[int, GBuffer] = {}
    points = [(name, Case(**{**case, name: value})) for name, values in sweeps.items() for value in values]
    for number, (sweep, at) in enumerate(points):
        drawn = _like(family, at)
        seconds, differences, levels = [], [], []
        for index in range(scenes):
            rngs = np.random.default_rng([seed, index]).spawn(2)
            scene = pack(drawn.sample(*rngs, held_out=False)).views([0])
            gbuffer, took = _made(scene, at.resolution, at.samples, seed=1)
            seconds.append(took)
            if sweep == "samples":
                if index not in exact:  # the same scene for every number of samples
                    exact[index], _ = _made(scene, at.resolution, converged, seed=2)
                mine, theirs = (np.stack(_radiance(g, scene)) for g in (gbuffer, exact[index]))
                differences.append(np.abs(mine - theirs).mean(axis=(1, 2, 3)))
                levels.append(theirs.mean(axis=(1, 2, 3)))
            progress(number * scenes + index + 1, len(points) * scenes)
        error = np.mean(differences, axis=0) / np.mean(levels, axis=0) if levels else [None] * len(_LIGHT)
        yield {
            "sweep": sweep,
            **vars(at),
            **{f"{part}_s": median(took[part] for took in seconds) for part in seconds[0]},
            **{f"{name}_error": None if e is None else float(e) for name, e in zip(_LIGHT, error, strict=True)},
            "images": scenes,
        }


def _like(family: SceneFamily, case: Case) -> SceneFamily:
    """The family with so many triangles and lights, in up to 70 objects."""
    budget = TriangleBudget(scene=(case.triangles - 100, case.triangles), objects=(3, 70), per_object=(50, 4000))
    return replace(family, budget=budget, lights=replace(family.lights, count=(case.lights, case.lights)))


def _made(scene: PackedScene, resolution: int, samples: int, seed: int) -> tuple[GBuffer, dict[str, float]]:
    """A G-buffer of all there is, and the seconds that each part took."""
    triangles, c2w, fov = scene.triangles, scene.c2w[0], scene.fov[0]
    took: dict[str, float] = {}

    def timed(part: str, make: Callable[[], Result]) -> Result:
        begin = time.perf_counter()
        made = make()
        took[part] = time.perf_counter() - begin
        return made

    caster, lights = timed("structures", lambda: (camera_caster(triangles), LightSampler(triangles)))
    seen = timed("first_hit", lambda: first_hit(triangles, c2w, fov, resolution, resolution, caster))
    return timed("light", lambda: with_known_light(seen, c2w, fov, lights, samples, seed)), took


def _radiance(gbuffer: GBuffer, scene: PackedScene) -> list[np.ndarray]:
    """[H, W, 3] what each kind of light adds to the image."""
    material, fov = scene.triangles.material, scene.fov[0]
    return [
        channel(gbuffer, material, fov, albedo) * channel(gbuffer, material, fov, light)
        for light, albedo in _LIGHT.items()
    ]

"""The first bounce: light that reaches what a camera sees straight from the emitters, shadows included.

The term T L_e of the rendering equation's series L = L_e + T L_e + T² L_e + …, at every pixel's first hit. It needs
no more than the G-buffer does: the scene, its lights and a ray caster.

Diffuse: Lambert's exact formula for each emitting triangle, times the share of it that is in sight, which shadow rays
estimate; so fully visible light carries no noise. The formula's cost grows with the triangles, so a finely modelled
lamp is left to its light samples. Glossy: light samples (the same shadow rays) and lobe samples combined by multiple
importance sampling, which serves mirrors under small lights and dull surfaces under large ones alike, with the lobe
itself and no fitted approximation of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer import ggx
from rfpp.gbuffer.first_hit import DirectLight, GBuffer
from rfpp.gbuffer.light_loops import along_lobe, from_light, from_lobe, toward_light
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.surface import CLEARANCE, Surface, chunks
from rfpp.scene.triangles import DIFFUSE, SPECULAR


def with_direct_light(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    samples: int,
    seed: int = 0,
) -> GBuffer:
    """The same G-buffer with the direct light at its hits.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        samples: shadow rays per light and pixel, and as many in all for the glossy lobe. Where no shadow's edge runs,
            diffuse light is exact with any number.
        seed: of the samples' displacement from pixel to pixel; the same seed gives the same numbers.
    """
    surface = Surface.seen(gbuffer, sampler.triangles, c2w, fov)
    maps = np.zeros((2, *gbuffer.depth.shape, 3), np.float32)
    maps[:, gbuffer.hit] = gathered(sampler, surface, samples, np.random.default_rng(seed))
    return replace(gbuffer, light=DirectLight(*maps))


def direct_radiance(gbuffer: GBuffer, material: Float[np.ndarray, "m 10"]) -> Float[np.ndarray, "h w 3"]:
    """Outgoing radiance of the direct light in a G-buffer that holds it: diffuse plus glossy.

    Args:
        material: [M, 10] of the same triangles (`SceneTriangles.material`).
    """
    seen = material[gbuffer.triangle] * gbuffer.hit[..., None]
    return gbuffer.light.diffuse * seen[..., DIFFUSE] + gbuffer.light.glossy * seen[..., SPECULAR]


def gathered(
    sampler: LightSampler, surface: Surface, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "2 r 3"]:
    """Diffuse and glossy light at every point, in the units of `DirectLight`.

    Args:
        samples: see `with_direct_light`.
        rng: of the samples' displacement from point to point.
    """
    shifts = rng.random((len(surface), sampler.lights + 1, 2))
    light = np.zeros((2, len(surface), 3))
    if sampler.lights:
        for rows in chunks(len(surface), samples):
            light[:, rows] = _gathered(sampler, surface.part(rows), shifts[rows], samples)
    return light


def _gathered(
    sampler: LightSampler, surface: Surface, shifts: Float[np.ndarray, "r lights_plus_1 2"], samples: int
) -> Float[np.ndarray, "2 r 3"]:
    """As `gathered`, of points with a displacement each."""
    cosine = (surface.view * surface.normal).sum(-1)
    shines = (surface.specular > 0).any(-1) & (cosine > 0)
    seen = surface.normal, surface.view, np.where(shines, surface.alpha, -1.0)
    light = np.zeros((2, len(surface), 3))
    for number in sampler.shining:
        _add_light(light, sampler, number, surface.point, seen, shifts[:, number], samples)
    _add_lobe(light[1], sampler, surface.point, seen, shifts[:, -1], samples)
    light[1] *= ggx.multiple_scattering(cosine, surface.alpha, surface.specular) / samples
    return light


def _add_light(
    light: Float[np.ndarray, "2 r 3"],
    sampler: LightSampler,
    number: int,
    points: Float[np.ndarray, "r 3"],
    seen: tuple[np.ndarray, ...],
    shifts: Float[np.ndarray, "r 2"],
    samples: int,
) -> None:
    """What shadow rays to one light bring.

    Args:
        seen: normals, views and α, of which negative ones do not shine.
    """
    one, shape = sampler.each[number], (len(points), samples)
    way, (reach, density, arriving) = np.empty((*shape, 3)), np.empty((3, *shape))
    emitter = np.empty(shape, np.int64)
    toward_light(points, seen[0], np.ascontiguousarray(shifts), one, way, reach, density, emitter, arriving)
    in_sight = arriving > 0
    rows = np.nonzero(in_sight)[0]
    in_sight[in_sight] = ~sampler.caster.occluded(points[rows], way[in_sight], reach[in_sight] - CLEARANCE)
    from_light(points, *seen, one, way, density, emitter, arriving, in_sight, *light)


def _add_lobe(
    glossy: Float[np.ndarray, "r 3"],
    sampler: LightSampler,
    points: Float[np.ndarray, "r 3"],
    seen: tuple[np.ndarray, ...],
    shifts: Float[np.ndarray, "r 2"],
    samples: int,
) -> None:
    """What rays of the glossy lobe bring that meet emitters."""
    shining = np.flatnonzero(seen[2] >= 0)
    way, cosine = np.empty((len(shining), samples, 3)), np.empty((len(shining), samples))
    along_lobe(*(of_points[shining] for of_points in seen), shifts[shining], way, cosine)
    rows, up = np.repeat(shining, samples).reshape(cosine.shape)[cosine > 0], way[cosine > 0]
    hits = sampler.caster.cast(points[rows], up)
    emitter = sampler.emitter_of(hits.triangle)
    met = sampler.shines(emitter)
    lit = rows[met], up[met], hits.distance[met].astype(np.float64), emitter[met]
    from_lobe(*seen, *lit, sampler.whole, glossy)

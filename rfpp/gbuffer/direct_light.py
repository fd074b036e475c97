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
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.polygon_light import form_factor
from rfpp.gbuffer.surface import CLEARANCE, Surface, chunks, lattice, local
from rfpp.scene.triangles import DIFFUSE, SPECULAR

#: Triangles of a light up to which Lambert's formula is used.
_FORMULA_UP_TO = 16


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
        per_point = max(samples, min(_FORMULA_UP_TO, len(sampler.corners)))
        for rows in chunks(len(surface), per_point):
            light[:, rows] = _gathered(sampler, surface.part(rows), shifts[rows], samples)
    return light


def _gathered(
    sampler: LightSampler, surface: Surface, shifts: Float[np.ndarray, "r lights_plus_1 2"], samples: int
) -> Float[np.ndarray, "2 r 3"]:
    """As `gathered`, of points with a displacement each."""
    frame = surface.frame()
    view = local(surface.view, frame)
    shines = (surface.specular > 0).any(-1) & (view[:, 2] > 0)
    diffuse, glossy = np.zeros((2, *surface.point.shape))
    for light in range(sampler.lights):
        target, emitter = sampler.points(light, lattice(samples, shifts[:, light]))
        way = target - surface.point[:, None]
        distance = np.linalg.norm(way, axis=-1)
        way /= distance[..., None]
        density = sampler.density(emitter, way, distance)
        incoming = local(way, frame)
        arriving = sampler.radiance[emitter].mean(-1) * incoming[..., 2].clip(0) / density
        in_sight = arriving > 0
        rows = np.nonzero(in_sight)[0]
        reach = distance[in_sight] - CLEARANCE
        in_sight[in_sight] = ~sampler.caster.occluded(surface.point[rows], way[in_sight], reach)

        mine = np.flatnonzero(sampler.light == light)
        if len(mine) <= _FORMULA_UP_TO:
            unshadowed = form_factor(surface.point, surface.normal, sampler.corners[mine])
            visible = (arriving * in_sight).sum(1) / np.maximum(arriving.sum(1), 1e-30)
            diffuse += (unshadowed @ sampler.radiance[mine]) * visible[:, None]
        else:
            weight = incoming[..., 2].clip(0) / density * in_sight / (np.pi * samples)
            diffuse += np.einsum("rs,rsc->rc", weight, sampler.radiance[emitter])

        used = in_sight & shines[:, None]
        rows = np.nonzero(used)[0]
        reflected, by_lobe = _lobe(view[rows], incoming[used], surface.alpha[rows])
        weight = reflected * _over_density(density[used], by_lobe)
        np.add.at(glossy, rows, weight[:, None] * sampler.radiance[emitter[used]])

    rows = np.repeat(np.flatnonzero(shines), samples)
    incoming = ggx.sample(view[rows], surface.alpha[rows], lattice(samples, shifts[shines, -1]).reshape(-1, 2))
    way = np.einsum("rk,rkx->rx", incoming, frame[rows])
    hits = sampler.caster.cast(surface.point[rows], way)
    emitter = sampler.emitter_of(hits.triangle)
    used = (emitter >= 0) & (incoming[:, 2] > 0)
    rows, emitter = rows[used], emitter[used]
    reflected, by_lobe = _lobe(view[rows], incoming[used], surface.alpha[rows])
    by_light = sampler.density(emitter, way[used], hits.distance[used].astype(np.float64))
    np.add.at(glossy, rows, (reflected * _over_density(by_lobe, by_light))[:, None] * sampler.radiance[emitter])

    glossy *= ggx.multiple_scattering(view[:, 2], surface.alpha, surface.specular) / samples
    return np.stack([diffuse, glossy])


def _lobe(
    view: Float[np.ndarray, "n 3"], light: Float[np.ndarray, "n 3"], alpha: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """What the glossy lobe reflects from each direction, and the density of its own samples there."""
    return ggx.lobe(view, light, alpha), ggx.pdf(view, light, alpha)


def _over_density(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 / own density, times the weight of a sample that the other way of sampling could have given too.

    The power heuristic own² / (own² + other²) (Veach 1997): a sharp lobe is left to its own samples, which see the
    light whole, where light samples would hit the lobe now and then and sparkle.
    """
    return own / (own**2 + other**2)

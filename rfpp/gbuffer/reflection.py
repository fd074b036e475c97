"""What shiny surfaces show: the direct light that leaves where the rays arrive that the glossy lobe throws.

Part of the term T² L_e of the rendering equation's series: the glossy lobe at the first hit, all of the material at
the second. No first-hit buffer can help with it, since a mirror shows what is elsewhere. Rays are drawn from the lobe,
so on a mirror they are the mirrored ray, all of them, and the picture in it is sharp; on a dull surface they spread as
the light does. A ray that meets an emitter brings nothing: this light is direct light, and counted there.

A dull surface that sees a small highlight in a shiny one would sparkle: few of its rays find it. As in the reference
images, whose path tracer does so at its default ("Filter Glossy" 1 of Cycles), the shinier surface is blurred then.
"""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer import ggx
from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.first_hit import GBuffer, Reflection
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.ray_ends import blurred, density_of_lobes, surface_at
from rfpp.gbuffer.surface import Surface, chunks, lattice, local


def with_reflection(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    samples: int,
    seed: int = 0,
) -> GBuffer:
    """The same G-buffer with what its surfaces reflect.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        samples: rays per pixel; from where each arrives, one shadow ray to each light.
        seed: of the rays' displacement from pixel to pixel; the same seed gives the same numbers.
    """
    surface = Surface.seen(gbuffer, sampler.triangles, c2w, fov)
    rng = np.random.default_rng(seed)
    maps = np.zeros((2, *gbuffer.depth.shape, 3), np.float32)
    light = np.zeros((2, len(surface), 3))
    shiny = np.flatnonzero((surface.specular > 0).any(-1))
    for rows in chunks(len(shiny), samples):
        light[:, shiny[rows]] = _reflected(sampler, surface.part(shiny[rows]), samples, rng)
    maps[:, gbuffer.hit] = light
    return replace(gbuffer, reflection=Reflection(*maps))


def _reflected(
    sampler: LightSampler, surface: Surface, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "2 r 3"]:
    """Light and albedo as the lobe of every point gathers them."""
    frame = surface.frame()
    view = local(surface.view, frame)
    rows = np.repeat(np.flatnonzero(view[:, 2] > 0), samples)
    shifts = rng.random((len(surface), 2))[view[:, 2] > 0]
    incoming = ggx.sample(view[rows], surface.alpha[rows], lattice(samples, shifts).reshape(-1, 2))
    way = np.einsum("rk,rkx->rx", incoming, frame[rows])
    up = np.flatnonzero(incoming[:, 2] > 0)
    rows, incoming, way = rows[up], incoming[up], way[up]
    met, there = surface_at(sampler, surface.point[rows], way, sampler.caster.cast(surface.point[rows], way))
    rows, incoming = rows[met], incoming[met]
    by_lobe = ggx.pdf(view[rows], incoming, surface.alpha[rows])
    there = blurred(there, density_of_lobes(surface.part(rows), incoming[:, 2], by_lobe))
    diffuse, glossy = gathered(sampler, there, 1, rng)
    weight = ggx.lobe(view[rows], incoming, surface.alpha[rows]) / by_lobe

    reflected = np.zeros((2, len(surface), 3))
    np.add.at(reflected[0], rows, weight[:, None] * (there.diffuse * diffuse + there.specular * glossy))
    np.add.at(reflected[1], rows, weight[:, None] * (there.diffuse + there.specular))
    return reflected * ggx.multiple_scattering(view[:, 2], surface.alpha, surface.specular) / samples

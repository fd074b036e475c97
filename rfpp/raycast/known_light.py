"""Direct light at the pixels of an image, and its reflections in glossy surfaces.

Direct light is the term T L_e of the rendering equation's series L = L_e + T L_e + T² L_e + … Diffuse light is
Lambert's exact formula for each emitting triangle, corrected by shadow rays, so that fully visible light has no noise;
lights of many triangles are sampled. Glossy light combines samples of the lights (the same shadow rays) and of the lobe
by multiple importance sampling.

Reflections are part of T² L_e: the glossy lobe at the first hit, the whole material at the second. Rays are drawn from
the lobe. A rough surface that reflects a small highlight would sparkle, because few of its rays find it; the glossier
surface is then blurred (`lit_scene.blurred`).

Every pixel sends a few shadow rays to each light. Pixels near shadow edges and in highlights send the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Float32

from rfpp.raycast.first_hit import DirectLight, GBuffer, Reflection
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.pixel_loops import SUMS, light_samples, lobe_rays, of_light, shares_around, to_image
from rfpp.raycast.polygon_light import SCRATCH_ROWS
from rfpp.raycast.shadow_edges import find_edges
from rfpp.raycast.surface import Points, Surface
from rfpp.raycast.threads import over_rows
from rfpp.raycast.traces import Trace

#: Shadow rays of each pixel to each light before edges are searched, and pixels around an edge that take all samples.
_PROBES, _REACH = 4, 2


def with_known_light(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    samples: int,
    seed: int = 0,
    reflects: bool = True,
    traced: bool = False,
) -> GBuffer:
    """Return the G-buffer with direct light at its hits and, if `reflects`, reflections.

    Args:
        gbuffer: G-buffer of the sampler's scene.
        c2w, fov: Its camera, as in `rfpp.raycast.first_hit.first_hit`.
        sampler: Lights of the scene.
        samples: Shadow rays per point to each light at edges of shadows, and rays of the glossy lobe.
        seed: Seed of the samples' displacement from pixel to pixel.
        reflects: Also compute reflections of other surfaces.
        traced: Also record the derivatives of reflections.
    """
    surface = Surface.at_hits(gbuffer, sampler.triangles, c2w, fov)
    height, width = (side // gbuffer.points for side in gbuffer.depth.shape)
    of_image = surface.points(gbuffer.hit, gbuffer.points)
    light = np.zeros((3, len(surface), 3), np.float32)
    diffuse, glossy, reflected = light
    keys = np.random.default_rng(seed).integers(1 << 62, size=2).tolist()
    scratch = np.empty((len(surface), SUMS)), np.empty((SCRATCH_ROWS, len(surface)))
    for number in np.flatnonzero(sampler.scene.shining).tolist():
        _add_light(sampler, number, of_image, (height, width), samples, keys[0], scratch, diffuse, glossy)
    trace = Trace.of(len(surface), samples if traced else 0)
    image = (of_image, width, samples, reflects, keys[1], glossy, reflected, trace)
    over_rows(len(surface), lobe_rays, sampler.scene, *image)
    maps = np.zeros((3, *gbuffer.depth.shape, 3), np.float32)
    over_rows(len(surface), to_image, np.flatnonzero(gbuffer.hit), light, maps.reshape(3, -1, 3))
    found = replace(gbuffer, light=DirectLight(*maps[:2]))
    if not reflects:
        return found
    return replace(found, reflection=Reflection(maps[2], trace if traced else None))


def _add_light(
    sampler: LightSampler,
    number: int,
    points: Points,
    size: tuple[int, int],
    samples: int,
    key: int,
    scratch: tuple[Float[np.ndarray, "r sums"], Float[np.ndarray, "scratch r"]],
    diffuse: Float32[np.ndarray, "r 3"],
    glossy: Float32[np.ndarray, "r 3"],
) -> None:
    """Add one light's direct light.

    Args:
        scratch: Scratch space for the sums of its samples, and for its light by formula.
    """
    rows, scene, (sums, unoccluded) = len(points.pixel), sampler.scene, scratch
    edge = np.ones(size[0] * size[1], np.bool_)
    few = min(-(-_PROBES // points.of_pixel), samples)
    over_rows(rows, light_samples, scene, number, points, size[1], 0, few, edge, key, sums)
    if few < samples:
        counts = np.zeros(len(edge), np.uint8), np.empty(size[1], np.uint8), np.zeros((len(edge), 3))
        find_edges(scene, number, points, sums, few, *size, _REACH, *counts, edge)
        over_rows(rows, light_samples, scene, number, points, size[1], few, samples, edge, key, sums)
    around = np.empty(len(edge))
    shares_around(points, sums, *size, np.zeros((len(edge), 2)), around)
    over_rows(rows, of_light, scene, number, points, around, edge, few, samples, sums, unoccluded, diffuse, glossy)

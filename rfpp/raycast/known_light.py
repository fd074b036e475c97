"""Known light: what reaches the pixels of an image straight from the emitters, and what shiny surfaces show of it.

Direct light is the term T L_e of the rendering equation's series L = L_e + T L_e + T² L_e + … Diffuse: Lambert's exact
formula for each emitting triangle, times the share of it that is in sight, which shadow rays estimate; so fully visible
light carries no noise. The formula's cost grows with the triangles, so a finely modeled lamp is left to its light
samples. Glossy: light samples (the same shadow rays) and lobe samples combined by multiple importance sampling, which
serves mirrors under small lights and dull surfaces under large ones alike.

Reflections are part of T² L_e: the glossy lobe at the first hit, all of the material at the second. No first-hit buffer
can help with them, since a mirror shows what is elsewhere. Rays are drawn from the lobe: on a mirror all are the
mirrored ray, and the picture in it is sharp; on a dull surface they spread as the light does. A dull surface that
sees a small highlight in a shiny one would sparkle: few of its rays find it. As in the reference images, whose path
tracer does so at its default ("Filter Glossy" 1 of Cycles), the shinier surface is blurred then.

The same rays of the lobe bring both. Shadow rays are spent where they count: every pixel sends a few to each light, and
only those at whose place, or near, some are blocked and some are not, or with a highlight there, send the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Float32

from rfpp.raycast.first_hit import DirectLight, GBuffer, Reflection
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.pixel_loops import SUMS, light_samples, lobe_rays, of_light, shares_around, to_image
from rfpp.raycast.polygon_light import ROOM
from rfpp.raycast.shadow_edges import find_edges
from rfpp.raycast.surface import Points, Surface
from rfpp.raycast.threads import over_rows
from rfpp.raycast.traces import Trace

#: Shadow rays of each pixel to each light that look for the edges of shadows, and how many pixels around an edge are
#: sampled in full.
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
    """The same G-buffer with the direct light at its hits and, if they are wanted, reflections.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.raycast.first_hit.first_hit`.
        samples: of each point: shadow rays to each light at the edges of shadows, and rays of the glossy lobe; those of
            a pixel's points are spread together.
        seed: of the samples' displacement from pixel to pixel; the same seed gives the same numbers.
        reflects: whether what surfaces reflect of other surfaces is wanted.
        traced: whether it is wanted where that comes from.
    """
    surface = Surface.seen(gbuffer, sampler.triangles, c2w, fov)
    height, width = (side // gbuffer.points for side in gbuffer.depth.shape)
    of_image = surface.points(gbuffer.hit, gbuffer.points)
    light = np.zeros((3, len(surface), 3), np.float32)
    diffuse, glossy, reflected = light
    keys = np.random.default_rng(seed).integers(1 << 62, size=2).tolist()
    room = np.empty((len(surface), SUMS)), np.empty((ROOM, len(surface)))
    for number in np.flatnonzero(sampler.scene.shining).tolist():
        _add_light(sampler, number, of_image, (height, width), samples, keys[0], room, diffuse, glossy)
    trace = Trace.of(len(surface), samples if traced else 0)
    image = (of_image, samples, reflects, keys[1], glossy, reflected, trace)
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
    room: tuple[Float[np.ndarray, "r sums"], Float[np.ndarray, "room r"]],
    diffuse: Float32[np.ndarray, "r 3"],
    glossy: Float32[np.ndarray, "r 3"],
) -> None:
    """Adds what one light brings.

    Args:
        room: for what its samples come to, and for its light by formula.
    """
    rows, scene, (sums, unhidden) = len(points.pixel), sampler.scene, room
    edge = np.ones(size[0] * size[1], np.bool_)
    few = min(-(-_PROBES // points.of_pixel), samples)
    over_rows(rows, light_samples, scene, number, points, 0, few, edge, key, sums)
    if few < samples:
        counts = np.zeros(len(edge), np.uint8), np.empty(size[1], np.uint8), np.zeros((len(edge), 3))
        find_edges(scene, number, points, sums, few, *size, _REACH, *counts, edge)
        over_rows(rows, light_samples, scene, number, points, few, samples, edge, key, sums)
    around = np.empty(len(edge))
    shares_around(points, sums, *size, np.zeros((len(edge), 2)), around)
    over_rows(rows, of_light, scene, number, points, around, edge, few, samples, sums, unhidden, diffuse, glossy)

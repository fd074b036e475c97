"""The first bounce object by object: the light that leaves an object as the emitters light it, shadows included.

The same term T L_e of the rendering equation's series that `rfpp.gbuffer.direct_light` finds at every pixel, here
averaged over each object's surface, for networks whose tokens stand for objects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.surface import Surface
from rfpp.scene.triangles import SceneTriangles

#: Points on each object, with one shadow ray to each light from either side.
POINTS = 64


def object_light(sampler: LightSampler) -> Float[np.ndarray, "o 3"]:
    """Radiance that leaves each object by the first bounce, a mean over its surface and over all directions.

    Light of both sides counts: a sheet is lit wherever it is lit, and inside a closed object it is dark. The same scene
    gives the same numbers. An object without any surface sends nothing.
    """
    triangles = sampler.triangles
    corners = triangles.positions.astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    has_surface = np.bincount(triangles.object_index, area, triangles.num_objects) > 0
    chosen, position = _points(triangles, area, np.flatnonzero(has_surface))
    a, b, c = np.moveaxis(corners[chosen], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    leaving = np.zeros((len(chosen), 3))
    for side in (normal, -normal):
        surface = Surface.at(triangles, chosen, position, side, position + side)
        # only irradiance is wanted, which the diffuse lobe gathers
        dull = replace(surface, specular=np.zeros_like(surface.specular))
        irradiance = gathered(sampler, dull, 1, np.random.default_rng(0))[0]
        leaving += (surface.diffuse + surface.specular) * irradiance
    light = np.zeros((triangles.num_objects, 3), np.float32)
    light[has_surface] = leaving.reshape(-1, POINTS, 3).mean(1)
    return light


def _points(
    triangles: SceneTriangles, area: Float[np.ndarray, " m"], objects: Int[np.ndarray, " o"]
) -> tuple[Int[np.ndarray, " r"], Float[np.ndarray, "r 3"]]:
    """The triangle and the place of POINTS points on each of these objects, spread evenly by area."""
    steps = np.concatenate([[0], np.cumsum(area)])
    first, last = triangles.object_offsets[objects], triangles.object_offsets[objects + 1]
    count = np.arange(POINTS)
    along = steps[first, None] + (count + 0.5) / POINTS * (steps[last] - steps[first])[:, None]
    chosen = np.searchsorted(steps, along, side="right") - 1
    chosen = chosen.clip(first[:, None], last[:, None] - 1).reshape(-1)
    # within triangles, the two-dimensional sequence that spreads best (Roberts 2018)
    inner = np.tile(np.stack([count * 0.7548776662466927 % 1, count * 0.5698402909980532 % 1], -1), (len(first), 1))
    root, share = np.sqrt(inner[:, :1]), inner[:, 1:]
    a, b, c = np.moveaxis(triangles.positions[chosen].astype(np.float64), 1, 0)
    return chosen, (1 - root) * a + root * (1 - share) * b + root * share * c

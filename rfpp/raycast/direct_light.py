"""Direct light at points of a scene, and the outgoing radiance of pixels; see `known_light`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.first_hit import GBuffer, channel
from rfpp.raycast.light_loops import gathered_each
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.surface import Surface
from rfpp.raycast.threads import over_rows


def direct_radiance(gbuffer: GBuffer, material: Float[np.ndarray, "m 10"]) -> Float[np.ndarray, "h w 3"]:
    """Return the outgoing radiance, diffuse plus glossy, of a G-buffer's direct light.

    Args:
        material: Materials of the scene's triangles (`SceneTriangles.material`).

    Raises:
        ValueError: If the G-buffer holds no direct light.
    """
    if gbuffer.light is None:
        raise ValueError("a G-buffer without direct light has no outgoing radiance: see with_known_light")
    albedo, specular = (channel(gbuffer, material, 0, name) for name in ("albedo", "specular"))
    radiance: np.ndarray = gbuffer.light.diffuse * albedo + gbuffer.light.glossy * specular
    return radiance


def gathered(
    sampler: LightSampler, surface: Surface, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "2 r 3"]:
    """Return diffuse and glossy light at every point, in the units of `DirectLight`.

    Args:
        samples: Shadow rays from each point to each light.
        rng: Generator of the samples' displacement from point to point.
    """
    light = np.zeros((2, len(surface), 3))
    of_each = surface.points(np.ones((len(surface), 1), np.bool_))
    key = int(rng.integers(1 << 62))
    over_rows(len(surface), gathered_each, sampler.scene, of_each, samples, key, *light)
    return light

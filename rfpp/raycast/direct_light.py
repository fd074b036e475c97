"""Direct light at any points of a scene, and the radiance that pixels send on of theirs; see `known_light`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.first_hit import GBuffer
from rfpp.raycast.light_loops import gathered_each
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.surface import Surface
from rfpp.raycast.threads import over_rows
from rfpp.scene.triangles import DIFFUSE, SPECULAR


def direct_radiance(gbuffer: GBuffer, material: Float[np.ndarray, "m 10"]) -> Float[np.ndarray, "h w 3"]:
    """Outgoing radiance of the direct light in a G-buffer that holds it: diffuse plus glossy.

    Args:
        material: [M, 10] of the same triangles (`SceneTriangles.material`).

    Raises ValueError if the G-buffer holds no direct light.
    """
    if gbuffer.light is None:
        raise ValueError("a G-buffer without direct light has none to send on: see with_known_light")
    seen: np.ndarray = material[gbuffer.triangle] * gbuffer.hit[..., None]
    radiance: np.ndarray = gbuffer.light.diffuse * seen[..., DIFFUSE] + gbuffer.light.glossy * seen[..., SPECULAR]
    return radiance


def gathered(
    sampler: LightSampler, surface: Surface, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "2 r 3"]:
    """Diffuse and glossy light at every point, in the units of `DirectLight`.

    Args:
        samples: shadow rays of each point to each light.
        rng: of the samples' displacement from point to point.
    """
    light = np.zeros((2, len(surface), 3))
    of_each = surface.points(np.ones((len(surface), 1), np.bool_))
    key = int(rng.integers(1 << 62))
    over_rows(len(surface), gathered_each, sampler.scene, of_each, samples, key, *light)
    return light

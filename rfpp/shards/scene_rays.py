"""Ray casting for stored scenes: G-buffers with direct light and reflections."""

from __future__ import annotations

from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.raycast.first_hit import GBuffer, camera_caster, first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.triangles import SceneTriangles


class SceneRays:
    """Ray casting for one scene and any number of cameras."""

    def __init__(self, triangles: SceneTriangles) -> None:
        self.triangles = triangles
        self._caster = camera_caster(triangles)
        self._lights = LightSampler(triangles)

    def first_hit(self, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat, resolution: int) -> GBuffer:
        """Return the square G-buffer of one camera, without light (`rfpp.raycast.first_hit`)."""
        return first_hit(self.triangles, c2w, fov, resolution, resolution, self._caster)

    def with_direct_light(
        self, gbuffer: GBuffer, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat, samples: int, seed: int
    ) -> GBuffer:
        """Add direct light to a G-buffer of this scene (`rfpp.raycast.known_light`)."""
        return with_known_light(gbuffer, c2w, fov, self._lights, samples, seed, reflects=False)

    def gbuffers(
        self,
        c2w: Float[np.ndarray, "v 4 4"],
        fov: Float[np.ndarray, " v"],
        resolution: int,
        samples: int,
        seed: np.random.SeedSequence,
    ) -> tuple[GBuffer, ...]:
        """Return the G-buffer of every camera with direct light and reflection, each sampled by its own seed."""
        seeds = seed.generate_state(len(c2w)).tolist()
        return tuple(
            with_known_light(self.first_hit(pose, angle, resolution), pose, angle, self._lights, samples, noise)
            for pose, angle, noise in zip(c2w, fov, seeds, strict=True)
        )

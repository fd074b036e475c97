"""The lights of a scene as something to draw points from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer.raycast import RayCaster
from rfpp.scene.triangles import EMISSION, SceneTriangles


class LightSampler:
    """The emitters of one scene and what stands between them and its surfaces; made once for any number of cameras.

    The emitting triangles of one object are one light, over which points are spread by power.

    Args:
        triangles: the whole scene, in world space.
        caster: over all of them, if there is one already; emitters cast shadows too.

    Attributes:
        caster: see above.
        emitters: [E] the emitting triangles' indices in the scene.
        corners, normal, radiance: [E, 3, 3], [E, 3], [E, 3] of them.
        light: [E] which light each belongs to.
        lights: how many lights there are.
    """

    def __init__(self, triangles: SceneTriangles, caster: RayCaster | None = None):
        self.triangles = triangles
        self.caster = caster or RayCaster(triangles.positions)
        self.emitters = np.flatnonzero(triangles.is_emissive)
        self.corners = triangles.positions[self.emitters].astype(np.float64)
        self.radiance = triangles.material[self.emitters][:, EMISSION].astype(np.float64)
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        size = np.linalg.norm(cross, axis=-1)
        self.normal, self._area = cross / size[:, None], size / 2
        names, self.light = np.unique(triangles.object_index[self.emitters], return_inverse=True)
        self.lights = len(names)
        power = self._area * self.radiance.mean(-1)
        self._share = power / np.bincount(self.light, power, self.lights)[self.light]
        self._emitter_of = np.full(len(triangles) + 1, -1)  # the last answers for rays that hit nothing
        self._emitter_of[self.emitters] = np.arange(len(self.emitters))

    def points(
        self, light: int, random: Float[np.ndarray, "r s 2"]
    ) -> tuple[Float[np.ndarray, "r s 3"], Int[np.ndarray, "r s"]]:
        """Points on a light, and the emitters (rows of `corners`) they lie on."""
        members = np.flatnonzero(self.light == light)
        share = self._share[members]
        steps = np.cumsum(share)
        chosen = np.searchsorted(steps, random[..., 0], side="right").clip(max=len(members) - 1)
        # what is left of the number within its step is uniform again
        left = np.clip((random[..., 0] - (steps - share)[chosen]) / share[chosen], 0, 1)
        root, along = np.sqrt(left)[..., None], random[..., 1, None]
        emitter = members[chosen]
        a, b, c = np.moveaxis(self.corners[emitter], -2, 0)
        return (1 - root) * a + root * (1 - along) * b + root * along * c, emitter

    def density(
        self,
        emitter: Int[np.ndarray, "*batch"],
        way: Float[np.ndarray, "*batch 3"],
        distance: Float[np.ndarray, "*batch"],
    ) -> Float[np.ndarray, "*batch"]:
        """Of `points`, per solid angle where unit vector `way` leads to them; infinite for a light seen edge-on."""
        facing = np.abs((way * self.normal[emitter]).sum(-1))
        with np.errstate(divide="ignore"):
            return self._share[emitter] / self._area[emitter] * distance**2 / facing

    def emitter_of(self, triangle: Int[np.ndarray, "*batch"]) -> Int[np.ndarray, "*batch"]:
        """The emitter that is this triangle of the scene; -1 for any other, and for -1."""
        return self._emitter_of[triangle]

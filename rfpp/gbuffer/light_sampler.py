"""The lights of a scene as something to draw points from."""

from __future__ import annotations

from copy import copy

import numpy as np
from jaxtyping import Bool, Int

from rfpp.errors import UserError
from rfpp.gbuffer.light_loops import Light
from rfpp.gbuffer.raycast import RayCaster
from rfpp.scene.triangles import EMISSION, SceneTriangles

#: Triangles of a light up to which Lambert's formula is used.
_FORMULA_UP_TO = 16


class LightSampler:
    """The emitters of one scene and what stands between them and its surfaces; made once for any number of cameras.

    The emitting triangles of one object are one light, over which points are spread by power.

    Args:
        triangles: the whole scene, in world space.
        caster: over all of them, if there is one already; emitters cast shadows too.

    Attributes:
        caster: see above.
        lights: how many there are.
        names: of the objects that they are.
        shining: the lights whose light is gathered; the others are black, and otherwise what they are.
        each, whole: every light, and all of them as one.
    """

    def __init__(self, triangles: SceneTriangles, caster: RayCaster | None = None):
        self.triangles = triangles
        self.caster = caster or RayCaster(triangles.positions)
        emitters = np.flatnonzero(triangles.is_emissive)
        corners = triangles.positions[emitters].astype(np.float64)
        radiance = triangles.material[emitters][:, EMISSION].astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=-1)
        normals, area = cross / size[:, None], size / 2
        names, light = np.unique(triangles.object_index[emitters], return_inverse=True)
        self.lights, self.names = len(names), triangles.light_names
        self.shining, self._light = tuple(range(self.lights)), light
        power = area * radiance.mean(-1)
        share = power / np.bincount(light, power, self.lights)[light]

        def of(rows: np.ndarray) -> Light:
            steps = np.cumsum(share[rows])
            formula = len(rows) <= _FORMULA_UP_TO
            return Light(corners[rows], normals[rows], radiance[rows], steps, share[rows] / area[rows], formula)

        self.each = tuple(of(np.flatnonzero(light == number)) for number in range(self.lights))
        self.whole = of(np.arange(len(emitters)))
        self._emitter_of = np.full(len(triangles) + 1, -1)  # the last answers for rays that hit nothing
        self._emitter_of[emitters] = np.arange(len(emitters))

    def only(self, name: str) -> LightSampler:
        """The same, of which one light shines. Raises UserError if there is none of this name."""
        if name not in self.names:
            raise UserError(f"light '{name}' does not exist: choose from {', '.join(self.names)}")
        other = copy(self)
        other.shining = (self.names.index(name),)
        return other

    def shines(self, emitter: Int[np.ndarray, "*batch"]) -> Bool[np.ndarray, "*batch"]:
        """Whether the row in `whole` belongs to a light that shines; not for -1."""
        return (emitter >= 0) & np.isin(self._light[emitter], self.shining)

    def emitter_of(self, triangle: Int[np.ndarray, "*batch"]) -> Int[np.ndarray, "*batch"]:
        """The row in `whole` of the triangles that emit; -1 for others, and for -1."""
        return self._emitter_of[triangle]

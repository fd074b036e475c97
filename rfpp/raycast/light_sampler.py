"""Lights of a scene, for sampling."""

from __future__ import annotations

from copy import copy

import numpy as np
from jaxtyping import Float

from rfpp.errors import UserError
from rfpp.raycast.ggx import lobe_albedo
from rfpp.raycast.lit_scene import LitScene
from rfpp.raycast.raycast import RayCaster
from rfpp.scene.triangles import EMISSION, SceneTriangles

#: Triangles of a light up to which Lambert's formula is used.
_FORMULA_UP_TO = 16


class LightSampler:
    """Emitters and occluders of one scene, for any number of cameras.

    The emitting triangles of one object are one light, sampled by power.

    Args:
        triangles: The whole scene, in world space.

    Attributes:
        names: Names of the objects that are lights.
        scene: Arrays for compiled loops.
    """

    def __init__(self, triangles: SceneTriangles, caster: RayCaster | None = None):
        self.triangles = triangles
        self.caster = caster or RayCaster(triangles.positions)
        emitters = np.flatnonzero(triangles.is_emissive)
        corners = triangles.positions[emitters].astype(np.float64)
        radiance = triangles.material[emitters][:, EMISSION].astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=-1)
        area = size / 2
        _, light = np.unique(triangles.object_index[emitters], return_inverse=True)
        self.names, count = triangles.light_names, np.bincount(light)
        power = area * radiance.mean(-1)
        share = power / np.bincount(light, power)[light] if len(light) else power
        facing = cross / size[:, None]
        one_sided = triangles.is_one_sided[emitters]
        solid, flat = np.zeros(len(count), np.bool_), count == 1
        even = np.array([np.ptp(radiance[light == number], axis=0).max() == 0 for number in range(len(count))], bool)
        others = triangles.positions[~triangles.is_emissive, 0]
        for number in np.flatnonzero((count > 1) & (count <= _FORMULA_UP_TO)):
            own = light == number
            flat[number] = (np.abs(facing[own] @ facing[own][0]) > 1 - 1e-6).all()
            if not flat[number] and not one_sided[own].any():
                facing[own], solid[number] = _outwards(corners[own], facing[own], area[own], others)
        bounds = [corners[light == number].reshape(-1, 3) for number in range(len(count))]
        middle = np.array([(own.min(0) + own.max(0)) / 2 for own in bounds]).reshape(-1, 3)
        reach = np.array([np.linalg.norm(own - at, axis=1).max() for own, at in zip(bounds, middle, strict=True)])
        emitter = np.full(len(triangles), -1)
        emitter[emitters] = np.arange(len(emitters))
        self.scene = LitScene(
            address=self.caster.address,
            positions=np.ascontiguousarray(triangles.positions, np.float32),
            normals=np.ascontiguousarray(triangles.normals, np.float32),
            material=np.ascontiguousarray(triangles.material, np.float32),
            emitter=emitter,
            corners=corners,
            facing=facing,
            radiance=radiance,
            steps=np.concatenate([np.zeros(0), *(np.cumsum(share[light == number]) for number in range(len(count)))]),
            one_sided=one_sided,
            area=area,
            share=share,
            first=np.concatenate([[0], np.cumsum(count)]),
            shining=np.ones(len(count), np.bool_),
            exact=(solid | flat) & even,
            solid=solid,
            middle=middle,
            reach=reach,
            **dict(zip(("albedo", "mean_albedo"), lobe_albedo(), strict=True)),
        )

    def only(self, name: str) -> LightSampler:
        """Return a sampler in which only this light shines. Raises UserError if there is none of this name."""
        if name not in self.names:
            raise UserError(f"light '{name}' does not exist: choose from {', '.join(self.names)}")
        other, shining = copy(self), np.arange(len(self.names)) == self.names.index(name)
        other.scene = self.scene._replace(shining=shining)
        return other


def _outwards(
    corners: Float[np.ndarray, "e 3 3"],
    facing: Float[np.ndarray, "e 3"],
    area: Float[np.ndarray, " e"],
    others: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "e 3"], bool]:
    """Return normals away from the center, and whether the triangles bound a convex body without other points."""
    middle = (corners.mean(1) * area[:, None]).sum(0) / area.sum()
    side = ((corners[:, 0] - middle) * facing).sum(-1, keepdims=True)
    outwards = np.where(side < 0, -facing, facing)
    offset, nearly = (corners[:, 0] * outwards).sum(-1), 1e-4 * np.abs(corners - middle).max()
    convex = (corners.reshape(-1, 3) @ outwards.T < offset + nearly).all()
    closed = np.linalg.norm((outwards * area[:, None]).sum(0)) < 1e-4 * area.sum()  # then vector areas cancel
    within = (np.einsum("ni,ei->ne", others, outwards) < offset).all(-1).any()
    return outwards, bool(convex and closed and not within)

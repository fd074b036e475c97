"""Lights of a scene, for sampling."""

from __future__ import annotations

from copy import copy

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import UserError
from rfpp.raycast.ggx import lobe_albedo
from rfpp.raycast.lit_scene import LitScene
from rfpp.raycast.raycast import RayCaster
from rfpp.scene.texels import Texels
from rfpp.scene.triangles import EMISSION, SceneTriangles

#: Triangles of a light up to which Lambert's formula is used.
_FORMULA_UP_TO = 20
#: Lights of the sampler. Where a scene has more, neighbors are sampled together: with noise, in bounded time.
_AT_MOST = 128


class LightSampler:
    """Emitters and occluders of one scene, for any number of cameras.

    The emitting triangles of one object are one light, sampled by power; those of several near ones in scenes with more
    than 128 such objects.

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
        emitters, self._owner, light = _lights(triangles, emitters)
        corners = triangles.positions[emitters].astype(np.float64)
        radiance = triangles.material[emitters][:, EMISSION].astype(np.float64)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(cross, axis=-1)
        area = size / 2
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
            if flat[number]:
                continue
            outwards, solid[number] = _outwards(corners[own], facing[own], area[own], others)
            if one_sided[own].any():
                solid[number] &= one_sided[own].all() and (outwards == facing[own]).all()
            else:
                facing[own] = outwards
        bounds = [corners[light == number].reshape(-1, 3) for number in range(len(count))]
        middle = np.array([(own.min(0) + own.max(0)) / 2 for own in bounds]).reshape(-1, 3)
        reach = np.array([np.linalg.norm(own - at, axis=1).max() for own, at in zip(bounds, middle, strict=True)])
        texels = Texels.none(len(triangles)) if triangles.texels is None else triangles.texels
        emitter = np.full(len(triangles), -1)
        emitter[emitters] = np.arange(len(emitters))
        self.scene = LitScene(
            address=self.caster.address,
            positions=np.ascontiguousarray(triangles.positions, np.float32),
            normals=np.ascontiguousarray(triangles.normals, np.float32),
            material=np.ascontiguousarray(triangles.material, np.float32),
            texel_level=texels.level,
            first_texel=texels.first,
            texels=texels.values,
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
        other, own = copy(self), self._owner == self.names.index(name)
        shining = np.add.reduceat(own, self.scene.first[:-1]) > 0
        radiance = np.where(own[:, None], self.scene.radiance, 0.0)
        other.scene = self.scene._replace(shining=shining, radiance=radiance)
        return other


def _lights(
    triangles: SceneTriangles, emitters: Int[np.ndarray, " e"]
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"], Int[np.ndarray, " e"]]:
    """Return the emitting triangles light by light, the number of each one's object among the lights, and its light."""
    _, owner = np.unique(triangles.object_index[emitters], return_inverse=True)
    count = np.bincount(owner)
    if len(count) <= _AT_MOST:
        return emitters, owner, owner
    middle = np.zeros((len(count), 3))
    np.add.at(middle, owner, triangles.positions[emitters].mean(axis=1))
    middle /= count[:, None]
    groups = [np.arange(len(count))]
    while 2 * len(groups) <= _AT_MOST:
        groups = [half for group in groups for half in _halves(middle, group)]
    light_of_object = np.zeros(len(count), np.int64)
    for number, group in enumerate(groups):
        light_of_object[group] = number
    order = np.argsort(light_of_object[owner], kind="stable")
    return emitters[order], owner[order], light_of_object[owner][order]


def _halves(middle: Float[np.ndarray, "l 3"], group: Int[np.ndarray, " g"]) -> list[Int[np.ndarray, " h"]]:
    """Split objects at the median along the axis of their largest extent."""
    axis = np.ptp(middle[group], axis=0).argmax()
    return np.array_split(group[np.argsort(middle[group, axis], kind="stable")], 2)


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

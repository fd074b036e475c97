"""Framing like training scenes: surfaces in [-0.5, 0.5]³, a camera one and a half to two units away."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.imported_scene import ImportedScene, Part, PunctualLight
from rfpp.scene.mesh import extent
from rfpp.scene.spec import Camera

_HALF = 0.5
#: A scene inside the box whose longest side is at least this keeps its scale.
_FILLS = 0.5
_VIEW = (0.5, -0.8, 0.45)  # from the front (-Y), the right and above
_DISTANCE, _FOV = 1.8, (30.0, 60.0)  # as in training scenes


@dataclass(frozen=True, eq=False)
class Framing:
    """The transform p → (p - center) · scale.

    Attributes:
        scale: positive.
        center: [3] float64.
    """

    scale: float
    center: Float[np.ndarray, 3]

    @classmethod
    def of(cls, parts: Sequence[Part]) -> Framing:
        """Return the transform that fits surfaces into the box, centered.

        It is the identity if they lie inside and fill half of the box along some axis.

        Raises:
            SceneError: If no surface is visible or none has an extent; without the file's name.
        """
        low, high = bounds(parts)
        longest = float((high - low).max())
        if not (0 < longest < math.inf):
            raise SceneError("its surfaces have no extent: check the mesh and its scale")
        if np.abs([low, high]).max() <= _HALF and longest >= _FILLS:
            return cls(1.0, np.zeros(3))
        return cls(2 * _HALF / longest, (low + high) / 2)

    @property
    def changes_nothing(self) -> bool:
        return self.scale == 1 and not self.center.any()

    def point(self, position: Float[np.ndarray, "*rows 3"]) -> Float[np.ndarray, "*rows 3"]:
        """Transform points."""
        return (position - self.center) * self.scale

    def light(self, light: PunctualLight) -> PunctualLight:
        """Transform a light; intensities scale with area, so that radiance is unchanged."""
        strength = light.strength if light.kind == "directional" else light.strength * self.scale**2
        return replace(light, strength=strength, position=self.point(light.position))

    def camera(self, camera: Camera) -> Camera:
        """Transform a camera. Raises SceneError if it is too far away."""
        position = self.point(np.array(camera.position))
        forward = np.subtract(camera.look_at, camera.position)
        return Camera(
            position=tuple(position.tolist()),
            look_at=tuple((position + forward / np.linalg.norm(forward)).tolist()),
            up=camera.up,
            fov=camera.fov,
        )

    def scene(self, scene: ImportedScene) -> ImportedScene:
        """Transform a scene."""
        if self.changes_nothing:
            return scene
        return replace(
            scene,
            parts=tuple(replace(part, vertices=self.point(part.vertices)) for part in scene.parts),
            punctual_lights=tuple(map(self.light, scene.punctual_lights)),
            cameras=tuple(map(self.camera, scene.cameras)),
        )


def default_camera(parts: Iterable[Part]) -> Camera:
    """Return a camera at the front right, above, whose view just contains the surfaces' bounding box."""
    low, high = bounds(parts)
    center = (low + high) / 2
    camera = Camera(position=_along(_VIEW, center), look_at=tuple(center.tolist()), fov=_FOV[1])
    box = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    pose = camera_to_world(camera).astype(np.float64)
    seen = (box - pose[:3, 3]) @ pose[:3, :3]
    angle = 2 * math.degrees(math.atan((np.abs(seen[:, :2]).max(axis=1) / -seen[:, 2]).max()))
    return camera.model_copy(update={"fov": min(max(angle, _FOV[0]), _FOV[1])})


def _along(direction: Sequence[float], center: np.ndarray) -> tuple[float, float, float]:
    return tuple((center + _DISTANCE * np.divide(direction, np.linalg.norm(direction))).tolist())


def bounds(parts: Iterable[Part]) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Return the bounds of all visible surfaces. Raises SceneError if there are none."""
    seen = [part.vertices for part in parts if not part.is_light and len(part)]
    if not seen:
        raise SceneError("holds no visible surface (emissive ones are invisible to the camera): add surfaces to be lit")
    lows, highs = zip(*map(extent, seen), strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)

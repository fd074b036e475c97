"""Where networks have seen scenes: surfaces in [-0.5, 0.5]³, a camera one and a half to two units away."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.imported_scene import ImportedScene, Lamp, Part
from rfpp.scene.mesh import extent
from rfpp.scene.spec import Camera

_HALF = 0.5
#: A scene whose longest side is at least this, inside the box, was made for it.
_FILLS = 0.5
_VIEW = (0.5, -0.8, 0.45)  # from the front (-Y), the right and above
_DISTANCE, _FOV = 1.8, (30.0, 60.0)  # of training's cameras


def framed(scene: ImportedScene, path: Path) -> ImportedScene:
    """The scene, scaled and moved so that its surfaces just fit into the box, their centre at its centre.

    Left as it is where it lies inside already and fills half of it along some axis. Radiance stays; a lamp's intensity
    is scaled by area, so that it lights the smaller scene as brightly.

    Raises:
        SceneError: without the file's name: nothing that a camera can see, or nothing with an extent.
    """
    low, high = bounds(scene.parts)
    longest = float((high - low).max())
    if not (0 < longest < math.inf):
        raise SceneError("its surfaces have no extent: check the mesh and its scale")
    if np.abs([low, high]).max() <= _HALF and longest >= _FILLS:
        return scene
    scale = 2 * _HALF / longest
    centre = (low + high) / 2
    warnings.warn(f"{path}: scaled by {scale:.4g} and centred, to fit into [-0.5, 0.5]³", stacklevel=4)
    return replace(
        scene,
        parts=tuple(replace(part, vertices=(part.vertices - centre) * scale) for part in scene.parts),
        lamps=tuple(_moved_lamp(lamp, scale, centre) for lamp in scene.lamps),
        cameras=tuple(_moved_camera(camera, scale, centre) for camera in scene.cameras),
    )


def default_camera(parts: Iterable[Part]) -> Camera:
    """From the front, the right and above, with the surfaces' bounding box just in view."""
    low, high = bounds(parts)
    centre = (low + high) / 2
    camera = Camera(position=_along(_VIEW, centre), look_at=tuple(centre.tolist()), fov=_FOV[1])
    box = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    pose = camera_to_world(camera).astype(np.float64)
    seen = (box - pose[:3, 3]) @ pose[:3, :3]
    angle = 2 * math.degrees(math.atan((np.abs(seen[:, :2]).max(axis=1) / -seen[:, 2]).max()))
    return camera.model_copy(update={"fov": min(max(angle, _FOV[0]), _FOV[1])})


def _along(direction: Sequence[float], centre: np.ndarray) -> tuple[float, float, float]:
    return tuple((centre + _DISTANCE * np.divide(direction, np.linalg.norm(direction))).tolist())


def bounds(parts: Iterable[Part]) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Of what cameras can see. Raises SceneError if that is nothing."""
    seen = [part.vertices for part in parts if not part.is_light and len(part)]
    if not seen:
        raise SceneError("holds no surface that a camera can see (emissive ones are invisible): add what is to be lit")
    lows, highs = zip(*map(extent, seen), strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _moved_lamp(lamp: Lamp, scale: float, centre: np.ndarray) -> Lamp:
    strength = lamp.strength if lamp.kind == "directional" else lamp.strength * scale**2
    return replace(lamp, strength=strength, position=(lamp.position - centre) * scale)


def _moved_camera(camera: Camera, scale: float, centre: np.ndarray) -> Camera:
    position = (np.array(camera.position) - centre) * scale
    forward = np.subtract(camera.look_at, camera.position)
    return Camera(
        position=tuple(position.tolist()),
        look_at=tuple((position + forward / np.linalg.norm(forward)).tolist()),
        up=camera.up,
        fov=camera.fov,
    )

"""Convert between the project's cameras and viser's."""

from __future__ import annotations

import math

import numpy as np
import viser

from rfpp.scene.camera import camera_to_world
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera, Scene


def cameras_of(scene: Scene | PackedScene) -> tuple[Camera, ...]:
    """Return a scene's cameras; those of a packed scene look at a point in front of them."""
    if isinstance(scene, Scene):
        return scene.cameras
    poses = zip(scene.c2w[:, :3].astype(float), scene.fov.tolist(), strict=True)
    return tuple(
        Camera(position=tuple(c2w[:, 3]), look_at=tuple(c2w[:, 3] - c2w[:, 2]), up=tuple(c2w[:, 1]), fov=fov)
        for c2w, fov in poses
    )


def aspect_of(client: viser.ClientHandle) -> float:
    """Return width / height of the window; 1 until the browser has sent it."""
    return client.camera.aspect or 1.0


def camera_of(client: viser.ClientHandle) -> Camera:
    """Return the visitor's camera: viser has the vertical angle in radians, rfpp the longer side's in degrees."""
    half = math.tan(client.camera.fov / 2) * max(1.0, aspect_of(client))
    return Camera(
        position=tuple(client.camera.position.tolist()),
        look_at=tuple(client.camera.look_at.tolist()),
        up=tuple(client.camera.up_direction.tolist()),
        fov=math.degrees(2 * math.atan(half)),
    )


def move_to(client: viser.ClientHandle, camera: Camera) -> None:
    """Move the visitor to a camera, so that its square image fits into the window.

    The visitor then orbits the point in front of the camera that is nearest to the origin, the center of all scenes.
    """
    forward = -camera_to_world(camera)[:3, 2]
    distance = max(0.1, float(-np.array(camera.position) @ forward))
    half = math.tan(math.radians(camera.fov) / 2) / min(1.0, aspect_of(client))
    with client.atomic():
        client.camera.up_direction = camera.up
        client.camera.position = camera.position
        client.camera.look_at = np.array(camera.position) + distance * forward
        client.camera.fov = 2 * math.atan(half)

"""PackedScene: the triangles and camera poses of a scene, the input of rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera, Scene
from rfpp.scene.triangles import SceneTriangles


@dataclass(frozen=True, eq=False)
class PackedScene:
    """Triangles and cameras of a scene, as produced by `pack` and stored in RenderFormer's H5 files.

    Attributes:
        triangles: all triangles in world space, sorted by object.
        c2w: [V, 4, 4] float32 camera-to-world, Blender axes.
        fov: [V] float32 degrees along the longer image side.
        texture: [M, 13, P, P] float32 if materials vary within triangles, see `rfpp.scene.texture`.
    """

    name: str
    triangles: SceneTriangles
    c2w: Float[np.ndarray, "v 4 4"]
    fov: Float[np.ndarray, " v"]
    texture: Float[np.ndarray, "m 13 p p"] | None = None

    def seen_by(self, cameras: Sequence[Camera]) -> PackedScene:
        """Return the same triangles with other cameras."""
        c2w, fov = poses(cameras)
        return replace(self, c2w=c2w, fov=fov)

    def views(self, indices: Sequence[int]) -> PackedScene:
        """Return the scene with some of its cameras."""
        return replace(self, c2w=self.c2w[list(indices)], fov=self.fov[list(indices)])


def pack(scene: Scene | PackedScene) -> PackedScene:
    """Return triangles and camera poses of a scene. Raises SceneError if nothing of an object is left."""
    if isinstance(scene, PackedScene):
        return scene
    return PackedScene(scene.name, SceneTriangles.from_scene(scene), *poses(scene.cameras))


def poses(cameras: Sequence[Camera]) -> tuple[Float[np.ndarray, "v 4 4"], Float[np.ndarray, " v"]]:
    """Return c2w and fov of look-at cameras, float32."""
    c2w = np.stack([camera_to_world(camera) for camera in cameras]) if cameras else np.zeros((0, 4, 4), np.float32)
    return c2w, np.array([camera.fov for camera in cameras], dtype=np.float32)

"""Checks that the arrays of a sample fit each other, which hashes cannot tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rfpp.errors import ShardError
from rfpp.imaging.exr import HALF_MAX
from rfpp.raycast.first_hit import GBuffer
from rfpp.scene.triangles import SceneTriangles


def require_consistent_scene(triangles: SceneTriangles, cameras: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError if the geometry's or the cameras' arrays do not fit each other."""
    count, sizes, names = len(triangles), np.diff(triangles.object_offsets), triangles.object_names
    if triangles.positions.shape != (count, 3, 3) or triangles.normals.shape != (count, 3, 3):
        raise ValueError("positions and normals differ in their number of triangles")
    if triangles.material.shape != (count, 10):
        raise ValueError("material has neither a row per triangle nor a row per object")
    if triangles.object_offsets[0] != 0 or sizes.min(initial=0) < 0 or sizes.sum() != count:
        raise ValueError("object_offsets do not end at the number of triangles")
    if len(names) != len(sizes) or not all(isinstance(name, str) for name in names):
        raise ValueError("meta.json does not name every object")
    if cameras["c2w"].shape != (*cameras["fov"].shape, 4, 4):
        raise ValueError("c2w and fov differ in their number of views")


def require_consistent_views(images: np.ndarray, gbuffers: Sequence[GBuffer], triangles: int) -> None:
    """Raise ValueError if a view's arrays differ in size or refer to missing triangles."""
    for image, gbuffer in zip(images, gbuffers, strict=True):
        parts = [part for part in (gbuffer, gbuffer.light, gbuffer.reflection) if part is not None]
        arrays = [value for part in parts for value in vars(part).values() if isinstance(value, np.ndarray)]
        if any(array.shape[:2] != image.shape[:2] for array in arrays):
            raise ValueError("the layers of a view differ in size")
        if gbuffer.triangle.max(initial=-1) >= triangles:
            raise ValueError("a view refers to missing triangles")


def require_consistent_light(token_light: np.ndarray, objects: int) -> None:
    """Raise ValueError if the light of surfaces is not that of 8 octants of every object."""
    if token_light.ndim != 4 or token_light.shape[:2] != (objects, 8) or token_light.shape[3] != 3:
        raise ValueError(f"token_light has the shape {token_light.shape}, which is not that of {objects} objects")


def require_half_range(image: np.ndarray, name: str) -> None:
    """Raise ShardError naming the image if a value is not finite or exceeds half precision."""
    if not np.isfinite(image).all():
        raise ShardError(f"{name}: NaN or infinite radiance: check the scene's materials and lights")
    if np.abs(image).max() > HALF_MAX:
        raise ShardError(
            f"{name}: radiance {np.abs(image).max():.6g} is beyond half precision ({HALF_MAX:.0f}): lower the emission"
        )

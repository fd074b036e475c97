"""Consistency checks of samples, which hashes cannot provide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rfpp.errors import ShardError
from rfpp.radiosity.cells import Cells, parts
from rfpp.raycast.first_hit import GBuffer
from rfpp.imaging.exr import HALF_MAX
from rfpp.scene.triangles import SceneTriangles

#: Of `Cells`, where rays end.
CELL_ENDS = ("hits", "onward")


def require_whole_scene(triangles: SceneTriangles, object_light: np.ndarray, cameras: Mapping[str, np.ndarray]) -> None:
    """Raises ValueError where arrays do not fit each other."""
    count, sizes, names = len(triangles), np.diff(triangles.object_offsets), triangles.object_names
    if triangles.positions.shape != (count, 3, 3) or triangles.normals.shape != (count, 3, 3):
        raise ValueError("positions and normals are not of as many triangles")
    if triangles.material.shape != (count, 10):
        raise ValueError("material is not of as many triangles or objects")
    if triangles.object_offsets[0] != 0 or sizes.min(initial=0) < 0 or sizes.sum() != count:
        raise ValueError("object_offsets do not end at the number of triangles")
    if len(names) != len(sizes) or not all(isinstance(name, str) for name in names):
        raise ValueError("meta.json does not name every object")
    if object_light.shape != (len(sizes), 3):
        raise ValueError("object_light is not of as many objects")
    if cameras["c2w"].shape != (*cameras["fov"].shape, 4, 4):
        raise ValueError("c2w is not of as many views as fov")


def require_whole_cells(cells: Cells, triangles: SceneTriangles) -> None:
    """Raises ValueError where arrays do not fit each other."""
    count = len(cells)
    if any(len(array) != count for array in parts(cells).values()):
        raise ValueError("cells' arrays are not of as many cells")
    octants, hits = cells.octant, np.stack([getattr(cells, name) for name in CELL_ENDS])
    if count and (octants.min() < 0 or octants.max() >= 8 * triangles.num_objects):
        raise ValueError("cells are of other objects")
    if count and (hits.min() < -1 or hits.max() >= count):
        raise ValueError("cells see others than there are")


def require_whole_views(images: np.ndarray, gbuffers: Sequence[GBuffer], triangles: int, cells: int) -> None:
    """Raises ValueError if arrays are inconsistent or refer to missing triangles or cells."""
    for image, gbuffer in zip(images, gbuffers, strict=True):
        parts = (gbuffer, gbuffer.light, gbuffer.reflection, gbuffer.cells)
        layers = [value for part in parts if part is not None for value in vars(part).values()]
        if any(x.shape[:2] != image.shape[:2] for x in layers if isinstance(x, np.ndarray)):
            raise ValueError("a view's layers are of different sizes")
        if gbuffer.triangle.max(initial=-1) >= triangles:
            raise ValueError("a view sees other triangles than there are")
        rays = () if gbuffer.cells is None else gbuffer.cells.rays.values()
        if any(seen.max(initial=-1) >= cells for seen in rays):
            raise ValueError("a view sees other cells than there are")


def require_half_range(image: np.ndarray, name: str) -> None:
    """Raises ShardError where a picture to be stored is not finite or beyond half precision."""
    if not np.isfinite(image).all():
        raise ShardError(f"{name}: NaN or infinite radiance: check the scene's materials and lights")
    if np.abs(image).max() > HALF_MAX:
        raise ShardError(
            f"{name}: radiance {np.abs(image).max():.6g} is beyond half precision ({HALF_MAX:.0f}): lower the emission"
        )

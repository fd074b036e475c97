"""A scene within a number of triangles."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.spec import Scene, SceneObject

#: An object keeps at least a tetrahedron.
_LEAST = 4


def within_budget(scene: Scene, triangles: int, source: str) -> Scene:
    """The scene with at most so many triangles, each object decimated to about its share; warns of what that changed.

    A face of a decimated object has the material of the nearest face before.

    Raises:
        SceneError: naming `source`, and the object that cannot be reduced so far.
    """
    before = [len(item.mesh) for item in scene.objects]
    if sum(before) <= triangles:
        return scene
    targets = _shares(before, triangles)
    if targets is None:
        raise SceneError(f"{source}: triangles={triangles} are too few for {len(before)} objects: "
                         f"give at least {sum(min(count, _LEAST) for count in before)}")  # fmt: skip
    objects = tuple(_reduced(item, target, source) for item, target in zip(scene.objects, targets, strict=True))
    after = sum(len(item.mesh) for item in objects)
    warnings.warn(f"{source}: {sum(before):,} triangles were reduced to {after:,}", stacklevel=3)
    return scene.model_copy(update={"objects": objects})


def _shares(counts: list[int], budget: int) -> list[int] | None:
    """How many faces each object may keep, in proportion to what it has; None if there are too many objects."""
    least = np.minimum(counts, _LEAST)
    left = budget - least.sum()
    if left < 0:
        return None
    rest = np.subtract(counts, least)
    return (least + np.floor(rest * (left / rest.sum())).astype(int)).tolist()


def _reduced(item: SceneObject, target: int, source: str) -> SceneObject:
    if len(item.mesh) <= target:
        return item
    try:
        mesh = decimated(item.mesh, target)
    except SceneError as error:
        raise SceneError(f"{source}: object '{item.name}': {error}") from None
    if item.face_material is None:
        return item.model_copy(update={"mesh": mesh})
    nearest = cKDTree(_centres(item.mesh)).query(_centres(mesh))[1]
    return item.model_copy(update={"mesh": mesh, "face_material": item.face_material[nearest]})


def _centres(mesh: Mesh) -> np.ndarray:
    """[F, 3]"""
    return mesh.corners.mean(axis=1)

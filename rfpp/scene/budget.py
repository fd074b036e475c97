"""Decimate a scene to a triangle budget."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.spec import Scene, SceneObject

#: An object keeps at least a tetrahedron.
_LEAST = 4


def within_budget(scene: Scene, triangles: int, source: str) -> Scene:
    """The scene with at most so many triangles, each object decimated to about its share; warns of what that changed.

    An object that cannot be reduced to its share, as loose triangles cannot, keeps more, and larger ones fewer.

    A face of a decimated object has the material of the nearest face before.

    Raises:
        SceneError: naming `source`: so few cannot be had.
    """
    before = [len(item.mesh) for item in scene.objects]
    if sum(before) <= triangles:
        return scene
    targets = _shares(before, triangles)
    if targets is None:
        raise SceneError(f"{source}: triangles={triangles} are too few for {len(before)} objects: "
                         f"give at least {sum(min(count, _LEAST) for count in before)}")  # fmt: skip
    objects = _reduced(scene.objects, targets)
    after = sum(len(item.mesh) for item in objects)
    if after > triangles:
        raise SceneError(f"{source}: cannot be reduced to triangles={triangles}: its objects keep {after:,}, give more")
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


def _reduced(objects: Sequence[SceneObject], targets: Sequence[int]) -> tuple[SceneObject, ...]:
    """From the smallest on; what one cannot be reduced by, the larger ones after it are reduced further."""
    result, owed = list(objects), 0
    for index in np.argsort([len(item.mesh) for item in objects], kind="stable"):
        item, target = objects[index], targets[index]
        mesh = _decimated(item.mesh, max(target - min(max(owed, 0), target // 2), 1))
        owed += len(mesh) - target
        result[index] = _with_mesh(item, mesh)
    return tuple(result)


def _decimated(mesh: Mesh, target: int) -> Mesh:
    """At most so many faces, or twice, four times … as many where that is as far as it goes."""
    while True:
        try:
            return decimated(mesh, target)
        except SceneError:  # not where the target is all it has
            target *= 2


def _with_mesh(item: SceneObject, mesh: Mesh) -> SceneObject:
    if item.face_material is None or mesh is item.mesh:
        return item.model_copy(update={"mesh": mesh})
    nearest = cKDTree(_centres(item.mesh)).query(_centres(mesh))[1]
    return item.model_copy(update={"mesh": mesh, "face_material": item.face_material[nearest]})


def _centres(mesh: Mesh) -> np.ndarray:
    """[F, 3]"""
    return mesh.corners.mean(axis=1)

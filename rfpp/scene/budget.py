"""Decimate a scene to a triangle budget."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.spec import Scene, SceneObject

#: Minimum number of faces of an object: a tetrahedron.
_LEAST = 4


def within_budget(scene: Scene, triangles: int, source: str) -> Scene:
    """Decimate a scene to at most `triangles` triangles, each object in proportion, with a warning.

    An object that cannot be decimated to its share keeps more faces, and larger objects fewer. A face of a decimated
    object takes the material of the nearest original face.

    Args:
        source: Name of the scene in messages.

    Raises:
        SceneError: If the scene cannot be decimated that far.
    """
    before = [len(item.mesh) for item in scene.objects]
    if sum(before) <= triangles:
        return scene
    targets = _shares(before, triangles)
    if targets is None:
        raise SceneError(f"{source}: triangles={triangles} is too few for {len(before)} objects: "
                         f"give at least {sum(min(count, _LEAST) for count in before)}")  # fmt: skip
    objects = _reduced(scene.objects, targets)
    after = sum(len(item.mesh) for item in objects)
    if after > triangles:
        raise SceneError(f"{source}: cannot be reduced to triangles={triangles}: its objects keep {after:,}: give more")
    warnings.warn(f"{source}: {sum(before):,} triangles were reduced to {after:,}", stacklevel=3)
    return scene.model_copy(update={"objects": objects})


def _shares(counts: list[int], budget: int) -> list[int] | None:
    """Return the number of faces of each object, in proportion; None if there are too many objects."""
    least = np.minimum(counts, _LEAST)
    left = budget - least.sum()
    if left < 0:
        return None
    rest = np.subtract(counts, least)
    return (least + np.floor(rest * (left / rest.sum())).astype(int)).tolist()


def _reduced(objects: Sequence[SceneObject], targets: Sequence[int]) -> tuple[SceneObject, ...]:
    """Decimate objects from the smallest; larger ones compensate for faces that smaller ones keep."""
    result, owed = list(objects), 0
    for index in np.argsort([len(item.mesh) for item in objects], kind="stable"):
        item, target = objects[index], targets[index]
        mesh = _decimated(item.mesh, max(target - min(max(owed, 0), target // 2), 1))
        owed += len(mesh) - target
        result[index] = _with_mesh(item, mesh)
    return tuple(result)


def _decimated(mesh: Mesh, target: int) -> Mesh:
    """Decimate to `target` faces, or to twice, four times … as many if that is impossible."""
    while True:
        try:
            return decimated(mesh, target)
        except SceneError:  # terminates at the mesh's own size
            target *= 2


def _with_mesh(item: SceneObject, mesh: Mesh) -> SceneObject:
    if item.face_material is None or mesh is item.mesh:
        return item.model_copy(update={"mesh": mesh})
    nearest = cKDTree(item.mesh.corners.mean(axis=1)).query(mesh.corners.mean(axis=1))[1]
    return item.model_copy(update={"mesh": mesh, "face_material": item.face_material[nearest], "texels": None})

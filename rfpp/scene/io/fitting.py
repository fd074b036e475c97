"""Fit imported scenes to the conditions of training scenes.

A scene is scaled into their box (`framing`), gets a camera if it has none, a floor if it has no surroundings
(`backdrop`), lights if it is dark (`light_rig`), and is split into objects (`grouping`). Each step is a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.io.backdrop import Backdrop, with_backdrop
from rfpp.scene.io.framing import Framing, default_camera
from rfpp.scene.io.grouping import merged
from rfpp.scene.io.imported_scene import ImportedScene, Part, name_of
from rfpp.scene.io.light_rig import with_lights
from rfpp.scene.io.limits import require_bounded
from rfpp.scene.mesh import Mesh, extent, has_area
from rfpp.scene.spec import Material, Scene, SceneObject, Transform
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: Treatment of transparent surfaces.
Transparent = Literal["opaque", "drop", "refuse"]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fitted scene.

    Attributes:
        framing: transform of its points, for later cameras.
    """

    scene: Scene
    framing: Framing


def fitted(scene: ImportedScene, path: Path, transparent: Transparent, backdrop: Backdrop) -> Fitted:
    """Fit a scene; see the module.

    Raises:
        SceneError: If nothing is visible, it is too large, or `transparent` refuses it; without the file's name.
    """
    require_bounded(sum(map(len, scene.parts)), len(scene.parts))
    scene = replace(scene, parts=tuple(part for part in _opaque(scene, transparent, path) if len(part)))
    framing = Framing.of(scene.parts)
    if not framing.changes_nothing:
        warnings.warn(f"{path}: scaled by {framing.scale:.4g} and centered to fit into [-0.5, 0.5]³", stacklevel=4)
    scene = framing.scene(scene)
    cameras = scene.cameras
    if not cameras:
        warnings.warn(f"{path}: it has no camera: one is added, in front and above", stacklevel=4)
        cameras = (default_camera(scene.parts),)
    scene = with_backdrop(scene, backdrop, path)
    objects = tuple(_objects(merged(with_lights(scene, cameras[0], path), path), path))
    return Fitted(Scene(name=name_of(scene.name, "scene"), objects=objects, cameras=cameras), framing)


def _opaque(scene: ImportedScene, transparent: Transparent, path: Path) -> tuple[Part, ...]:
    """Return the parts, with transparent ones made opaque or dropped."""
    materials = list(dict.fromkeys(part.see_through for part in scene.parts if part.see_through))
    if not materials:
        return scene.parts
    if transparent == "refuse":
        raise SceneError(f"{materials[0]}: is transparent, which cannot be represented: make it opaque in the file, or "
                         "load it with transparent=opaque or transparent=drop")  # fmt: skip
    became = "opaque (transparent=drop omits it)" if transparent == "opaque" else "omitted"
    named = materials[0] + (f" and {len(materials) - 1} more transparent ones" if len(materials) > 1 else "")
    warnings.warn(f"{path}: {named}: transparent surfaces are not supported, so it is {became}", stacklevel=5)
    return tuple(part for part in scene.parts if transparent == "opaque" or not part.see_through)


def _objects(parts: list[Part], path: Path) -> Iterator[SceneObject]:
    """Return objects with meshes about their own centers, so that edited transforms rotate about these."""
    for part in parts:
        low, high = extent(part.vertices)
        center = (low + high) / 2
        mesh = Mesh(part.vertices - center, part.faces)
        solid = has_area(Mesh(mesh.vertices + center, part.faces))  # in place, where numbers are coarser
        if not solid.any():
            warnings.warn(f"{path}: '{part.name}' has no area and is omitted", stacklevel=3)
            continue
        rows = part.material
        areas = part.areas * solid
        mean = np.average(rows, axis=0, weights=areas if areas.sum() > 0 else None).astype(np.float64)
        mean[:7] = np.clip(mean[:7], 0, 1)
        yield SceneObject(
            name=part.name,
            mesh=mesh,
            material=Material(
                diffuse=tuple(mean[DIFFUSE].tolist()),
                specular=tuple(mean[SPECULAR].tolist()),
                roughness=mean[ROUGHNESS].item(),
                emissive=tuple(mean[EMISSION].tolist()),
                one_sided=part.one_sided and part.is_light,
                smooth_shading=part.smooth,
            ),
            transform=Transform(translation=tuple(center.tolist()), normalize=False),
            face_material=None if (rows == rows[0]).all() and part.texels is None else rows,
            texels=part.texels,
        )

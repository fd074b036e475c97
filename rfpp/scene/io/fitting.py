"""An imported scene made into one that networks know.

It is fitted into their box (`framing`), given a camera if it has none, put on a floor if it has no surroundings
(`backdrop`), lit if it is dark (`light_rig`), and split into objects (`grouping`). A warning says so of each step.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.io.backdrop import Backdrop, stood
from rfpp.scene.io.framing import Framing, default_camera
from rfpp.scene.io.grouping import merged
from rfpp.scene.io.imported_scene import ImportedScene, Part, name_of
from rfpp.scene.io.light_rig import lit
from rfpp.scene.io.limits import require_bounded
from rfpp.scene.mesh import Mesh, extent, has_area
from rfpp.scene.spec import Material, Scene, SceneObject, Transform
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: What becomes of surfaces that light should pass through.
Transparent = Literal["opaque", "drop", "refuse"]


@dataclass(frozen=True, eq=False)
class Fitted:
    """What became of an imported scene.

    Attributes:
        scene: with a camera at least.
        framing: where its points went, for cameras that come later.
    """

    scene: Scene
    framing: Framing


def fitted(scene: ImportedScene, path: Path, transparent: Transparent, backdrop: Backdrop) -> Fitted:
    """The scene as networks know scenes; see the module.

    Args:
        path: what warnings call it.
        transparent, backdrop: see `load_scene`.

    Raises:
        SceneError: without a name: nothing that can be seen, too much, or what `transparent` refuses.
    """
    require_bounded(sum(map(len, scene.parts)), len(scene.parts))
    scene = replace(scene, parts=tuple(part for part in _solid(scene, transparent, path) if len(part)))
    framing = Framing.of(scene.parts)
    if not framing.changes_nothing:
        warnings.warn(f"{path}: scaled by {framing.scale:.4g} and centred, to fit into [-0.5, 0.5]³", stacklevel=4)
    scene = framing.scene(scene)
    cameras = scene.cameras
    if not cameras:
        warnings.warn(f"{path}: it has no camera: one is added, in front and above", stacklevel=4)
        cameras = (default_camera(scene.parts),)
    scene = stood(scene, backdrop, path)
    objects = tuple(_objects(merged(lit(scene, cameras[0], path), path), path))
    return Fitted(Scene(name=name_of(scene.name, "scene"), objects=objects, cameras=cameras), framing)


def _solid(scene: ImportedScene, transparent: Transparent, path: Path) -> tuple[Part, ...]:
    """The parts, with those that light should pass through as opaque as the others, or without them."""
    materials = list(dict.fromkeys(part.see_through for part in scene.parts if part.see_through))
    if not materials:
        return scene.parts
    if transparent == "refuse":
        raise SceneError(f"{materials[0]}: is transparent, which cannot be represented: make it opaque in the file, or "
                         "load it with transparent=opaque or transparent=drop")  # fmt: skip
    became = "opaque (transparent=drop leaves it out)" if transparent == "opaque" else "left out"
    named = materials[0] + (f" and {len(materials) - 1} more transparent ones" if len(materials) > 1 else "")
    warnings.warn(f"{path}: {named}: light cannot pass through a surface here, so it is {became}", stacklevel=5)
    return tuple(part for part in scene.parts if transparent == "opaque" or not part.see_through)


def _objects(parts: list[Part], path: Path) -> Iterator[SceneObject]:
    """Meshes about their own centres, so that an object turns about itself when its transform is edited."""
    for part in parts:
        low, high = extent(part.vertices)
        centre = (low + high) / 2
        mesh = Mesh(part.vertices - centre, part.faces)
        solid = has_area(Mesh(mesh.vertices + centre, part.faces))  # where it stands: numbers are coarser there
        if not solid.any():
            warnings.warn(f"{path}: '{part.name}' has no area and is left out", stacklevel=3)
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
                smooth_shading=part.smooth,
            ),
            transform=Transform(translation=tuple(centre.tolist()), normalize=False),
            face_material=None if (rows == rows[0]).all() else rows,
        )

"""Scene edits: transforms, materials and lights."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from rfpp.scene.spec import Material, Scene, SceneObject, Transform, Vector


def replaced(scene: Scene, edited: SceneObject) -> Scene:
    """The scene with this object in the place of the one of its name."""
    objects = tuple(edited if item.name == edited.name else item for item in scene.objects)
    return Scene(name=scene.name, objects=objects, cameras=scene.cameras)


def moved(item: SceneObject, **transform: object) -> SceneObject:
    """The object with other values of its transform. Raises SceneError for a bad one."""
    return SceneObject(**{**dict(item), "transform": Transform(**{**dict(item.transform), **transform})})


def quaternion(transform: Transform) -> Float[np.ndarray, " 4"]:
    """Its rotation as (w, x, y, z)."""
    return Rotation.from_euler("xyz", transform.rotation, degrees=True).as_quat(scalar_first=True)


def turned(quaternion: Float[np.ndarray, " 4"]) -> Vector:
    """(w, x, y, z), of any length but 0, as a `Transform.rotation`."""
    return tuple(Rotation.from_quat(quaternion, scalar_first=True).as_euler("xyz", degrees=True).tolist())


def remade(item: SceneObject, **material: object) -> SceneObject:
    """The object with other values of its material, the same for all of its faces. Raises SceneError for a bad one."""
    changed = Material(**{**dict(item.material), **material})
    return SceneObject(**{**dict(item), "material": changed, "face_material": None})


def power(item: SceneObject) -> float:
    """Emitted radiance of the strongest colour."""
    return max(item.material.emissive)


def tint(item: SceneObject) -> Vector:
    """Colour of the emitted light, its strongest component 1; white where there is none."""
    strongest = power(item)
    return tuple(e / strongest for e in item.material.emissive) if strongest else (1.0, 1.0, 1.0)


def shining(item: SceneObject, power: float, tint: Vector) -> SceneObject:
    """The light with this power and colour."""
    strongest = max(tint)
    colour = tuple(c / strongest for c in tint) if strongest else tint
    return remade(item, emissive=tuple(power * c for c in colour))

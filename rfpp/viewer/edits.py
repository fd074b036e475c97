"""Scene edits: transforms, materials and lights."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from rfpp.imaging.radiance import linear, srgb, to_8bit
from rfpp.scene.spec import Material, Scene, SceneObject, Transform, Vector


def with_object(scene: Scene, edited: SceneObject) -> Scene:
    """Return the scene with the object of the same name replaced."""
    objects = tuple(edited if item.name == edited.name else item for item in scene.objects)
    return Scene(name=scene.name, objects=objects, cameras=scene.cameras)


def with_transform(item: SceneObject, **transform: object) -> SceneObject:
    """Return the object with a changed transform. Raises SceneError for an invalid value."""
    return _changed(item, transform=Transform(**{**dict(item.transform), **transform}))


def with_material(item: SceneObject, **material: object) -> SceneObject:
    """Return the object with a changed material for all faces. Raises SceneError for an invalid value."""
    return _changed(item, material=Material(**{**dict(item.material), **material}), face_material=None)


def with_light(item: SceneObject, power: float, tint: Vector) -> SceneObject:
    """Return the object with changed emission, in the units of `power` and `tint`."""
    strongest = max(tint) or 1.0
    return with_material(item, emissive=tuple(power * c / strongest for c in tint))


def power(item: SceneObject) -> float:
    """Return the emitted radiance of the strongest color channel."""
    return max(item.material.emissive)


def tint(item: SceneObject) -> Vector:
    """Return the color of the emission, with a maximum of 1; white for an object without emission."""
    strongest = power(item)
    return tuple(e / strongest for e in item.material.emissive) if strongest else (1.0, 1.0, 1.0)


def quaternion(transform: Transform) -> Float[np.ndarray, " 4"]:
    """Return the rotation as (w, x, y, z)."""
    return Rotation.from_euler("xyz", transform.rotation, degrees=True).as_quat(scalar_first=True)


def rotation(quaternion: Float[np.ndarray, " 4"]) -> Vector:
    """Return (w, x, y, z), not necessarily normalized, as `Transform.rotation`."""
    return tuple(Rotation.from_quat(quaternion, scalar_first=True).as_euler("xyz", degrees=True).tolist())


def to_picker(color: Vector) -> tuple[int, int, int]:
    """Convert a linear color to the 8-bit sRGB of color pickers."""
    return tuple(to_8bit(srgb(torch.tensor(color))).tolist())


def from_picker(color: tuple[int, int, int]) -> Vector:
    """Convert the 8-bit sRGB of a color picker to a linear color."""
    return tuple(linear(torch.tensor(color, dtype=torch.float64) / 255).tolist())


def _changed(item: SceneObject, **parts: object) -> SceneObject:
    return SceneObject(**{name: getattr(item, name) for name in SceneObject.model_fields} | parts)

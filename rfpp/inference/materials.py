"""Materials of a scene's objects as tensors, of which images can be differentiated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.errors import UserError
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: Object → property (of `rfpp.scene.spec.Material`) → its tensor, which `MaterialTensors` checks.
Materials = Mapping[str, Mapping[str, Any]]
_COLUMNS = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "emissive": EMISSION}


@dataclass(frozen=True)
class MaterialTensors:
    """A scene with materials that are tensors.

    Attributes:
        scene: with their values.
        material: [M, 10] as `SceneTriangles` has it, on a device; its roughness is without gradient.
        given: property → object → its tensor there, of those that ask for a gradient.
    """

    scene: PackedScene
    material: Float[Tensor, "m 10"]
    given: Mapping[str, Mapping[str, Tensor]]

    @classmethod
    def of(cls, scene: PackedScene, materials: Materials, device: torch.device) -> MaterialTensors:
        """Raises UserError naming what does not exist, is geometry, or is no such number."""
        triangles = scene.triangles
        if scene.texture is not None:
            raise UserError(f"scene '{scene.name}': its materials vary over triangles, gradients are of constant ones")
        material, given = torch.from_numpy(triangles.material).to(device, copy=True), {name: {} for name in _COLUMNS}
        for name, properties in materials.items():
            if name not in triangles.object_names:
                raise UserError(f"object '{name}' does not exist: choose from {', '.join(triangles.object_names)}")
            number = triangles.object_names.index(name)
            rows = slice(*triangles.object_offsets[number : number + 2].tolist())
            shines = bool(triangles.is_emissive[rows].any())
            for what, value in properties.items():
                _check(what, value, name, shines)
                value = value.to(device, torch.float32)
                material[rows, _COLUMNS[what]] = value.detach() if what == "roughness" else value
                if value.requires_grad and torch.is_grad_enabled():
                    given[what][name] = value
        values = material.detach().cpu().numpy()
        return cls(replace(scene, triangles=replace(triangles, material=values)), material, given)

    def with_values(self, changes: Mapping[tuple[str, str], float]) -> PackedScene:
        """The scene with other values.

        Args:
            changes: (object, property) → value, of all colours.
        """
        triangles = self.scene.triangles
        material = triangles.material.copy()
        for (name, what), value in changes.items():
            material[triangles.object_index == triangles.object_names.index(name), _COLUMNS[what]] = np.float32(value)
        return replace(self.scene, triangles=replace(triangles, material=material))


def _check(what: str, value: Any, name: str, shines: bool) -> None:
    """Raises UserError where an object's property cannot be this tensor."""
    if what not in _COLUMNS:
        why = "there are gradients of materials alone, with geometry as it is"
        raise UserError(f"'{what}' of '{name}': {why}: choose from {', '.join(_COLUMNS)}")
    shapes = {"roughness": [()]}.get(what, [(3,)])
    if not isinstance(value, Tensor) or tuple(value.shape) not in shapes:
        wanted = "a tensor of one number, without axes" if what == "roughness" else "a tensor of three numbers"
        found = list(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise UserError(f"'{what}' of '{name}': {found} was given: give {wanted}")
    numbers = value.detach()
    if not torch.isfinite(numbers).all() or (numbers < 0).any() or (what != "emissive" and (numbers > 1).any()):
        wanted = "radiance is 0 or more" if what == "emissive" else "it lies between 0 and 1"
        raise UserError(f"'{what}' of '{name}' is {numbers.tolist()}: {wanted}: clamp it after each step")
    if what == "emissive" and shines != bool((numbers > 0).any()):
        why = "becomes no light" if not shines else "stays one: its image would change where it is seen"
        raise UserError(f"'emissive' of '{name}' is {numbers.tolist()}: what is {'a' if shines else 'no'} light {why}")

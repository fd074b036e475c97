"""Materials of a scene's objects as tensors with gradients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.errors import UserError
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: Object → property (of `rfpp.scene.spec.Material`) → tensor, checked by `MaterialTensors`.
Materials = Mapping[str, Mapping[str, Any]]
_COLUMNS = {"diffuse": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS, "emissive": EMISSION}


@dataclass(frozen=True)
class MaterialTensors:
    """A scene with the values of materials that are tensors."""

    scene: PackedScene
    material: Float[Tensor, "m 10"]  # as in `SceneTriangles`, on a device; roughness is detached
    given: Mapping[str, Mapping[str, Tensor]]  # property → object → tensor that requires a gradient

    @classmethod
    def of(cls, scene: PackedScene, materials: Materials, device: torch.device) -> MaterialTensors:
        """Replace materials of a scene. Raises UserError naming an unknown object or property, or an invalid value."""
        triangles = scene.triangles
        if scene.texture is not None:
            raise UserError(f"scene '{scene.name}': has textures: gradients need constant materials")
        material, given = torch.from_numpy(triangles.material).to(device, copy=True), {name: {} for name in _COLUMNS}
        for name, properties in materials.items():
            if name not in triangles.object_names:
                raise UserError(f"object '{name}' does not exist: choose from {', '.join(triangles.object_names)}")
            number = triangles.object_names.index(name)
            rows = slice(*triangles.object_offsets[number : number + 2].tolist())
            is_light = bool(triangles.is_emissive[rows].any())
            for key, value in properties.items():
                _check(key, value, name, is_light)
                value = value.to(device, torch.float32)
                material[rows, _COLUMNS[key]] = value.detach() if key == "roughness" else value
                if value.requires_grad and torch.is_grad_enabled():
                    given[key][name] = value
        values = material.detach().cpu().numpy()
        return cls(replace(scene, triangles=replace(triangles, material=values, texels=None)), material, given)

    def with_values(self, changes: Mapping[tuple[str, str], float]) -> PackedScene:
        """Return the scene with other values: (object, property) → value of all color channels."""
        triangles = self.scene.triangles
        material = triangles.material.copy()
        for (name, key), value in changes.items():
            material[triangles.object_index == triangles.object_names.index(name), _COLUMNS[key]] = value
        return replace(self.scene, triangles=replace(triangles, material=material))


def _check(key: str, value: Any, name: str, is_light: bool) -> None:
    """Raise UserError if an object's property cannot be this tensor."""
    if key not in _COLUMNS:
        raise UserError(f"'{key}' of '{name}': has no gradient: choose from {', '.join(_COLUMNS)}")
    shape, expected = ((), "a tensor without axes") if key == "roughness" else ((3,), "a tensor of three numbers")
    if not isinstance(value, Tensor) or tuple(value.shape) != shape:
        found = list(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise UserError(f"'{key}' of '{name}': {found} was given: give {expected}")
    numbers = value.detach()
    if not torch.isfinite(numbers).all() or (numbers < 0).any() or (key != "emissive" and (numbers > 1).any()):
        limits = "0 or more" if key == "emissive" else "between 0 and 1"
        raise UserError(f"'{key}' of '{name}' is {numbers.tolist()}, but must be {limits}: clamp it after each step")
    if key == "emissive" and is_light != bool((numbers > 0).any()):
        change = "a light cannot be switched off" if is_light else "other objects cannot become lights"
        raise UserError(f"'emissive' of '{name}' is {numbers.tolist()}: {change}: it would change geometry")

"""Export lights: points, spots and suns as lights of glTF, area lights as emissive surfaces."""

from __future__ import annotations

import math

import numpy as np

from .glb import Glb
from .materials import Warnings, constant, diffuse, emission, surface_of, tree_of

#: Lumens per watt in candela and lux, as in Blender's exporter.
_LUMENS_PER_WATT = 683.0
#: Corners of a disk.
_CORNERS = 24
_KINDS = {"POINT": "point", "SPOT": "spot", "SUN": "directional"}


def add_light(glb: Glb, light, name: str, matrix: np.ndarray, warnings: Warnings) -> None:
    """Add a `bpy.types.Light` with a world matrix [4, 4]."""
    if not light.use_shadow:
        warnings["Lights without shadows cast them"].append(name)
    watts = _watts(light, matrix) * _factor_of_nodes(light, name, warnings)
    if not watts.any():
        return
    if light.type == "AREA":
        _add_area(glb, light, name, matrix, watts, warnings)
        return
    strength = _LUMENS_PER_WATT * (watts if light.type == "SUN" else watts / (4 * math.pi))
    brightest = float(strength.max())
    entry = {"type": _KINDS[light.type], "color": (strength / brightest).tolist(), "intensity": brightest}
    if light.type == "SPOT":
        outer = light.spot_size / 2
        inner = math.acos(math.cos(outer) + light.spot_blend * (1 - math.cos(outer)))  # as Cycles blends
        entry["spot"] = {"outerConeAngle": outer, "innerConeAngle": min(inner, outer)}
    glb.node(name, matrix, extensions=glb.light(entry))


def _watts(light, matrix: np.ndarray) -> np.ndarray:
    """Return the power in watts [3], or of a sun its irradiance in W/m²."""
    color = np.array(light.color, np.float64)
    if getattr(light, "use_temperature", False):  # this and the following since Blender 4.5
        color *= np.array(light.temperature_color)
    energy = light.energy * 2.0 ** getattr(light, "exposure", 0.0)
    if not getattr(light, "normalize", True):
        from mathutils import Matrix

        energy *= light.area(matrix_world=Matrix(matrix.tolist()))
    return np.maximum(energy * color, 0.0)


def _factor_of_nodes(light, name: str, warnings: Warnings) -> np.ndarray:
    if tree_of(light) is None:
        return np.ones(3)
    shader = surface_of(light)
    if shader is not None and shader.type == "EMISSION":
        color, strength = (constant(shader.inputs[key]) for key in ("Color", "Strength"))
        if color is not None and strength is not None:
            return np.array(color)[:3] * strength
    warnings["Nodes of lights are ignored"].append(name)
    return np.ones(3)


def _add_area(glb: Glb, light, name: str, matrix: np.ndarray, watts: np.ndarray, warnings: Warnings) -> None:
    """Add a white, diffuse emitter that shines from its front, as glTF's surfaces do unless they are double-sided."""
    width = light.size
    height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else width
    corners = _outline(light.shape in ("DISK", "ELLIPSE")) * (width / 2, height / 2, 1.0)
    faces = np.array([(0, i, i - 1) for i in range(2, len(corners))], np.uint32)  # facing -Z, like the light
    a, b, c = np.moveaxis((corners @ matrix[:3, :3].T)[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2
    if not area > 0:
        warnings["Area lights without an area are omitted"].append(name)
        return
    material = glb.add("materials", {"name": name} | emission(diffuse((1, 1, 1)), watts / (math.pi * area), 1.0))
    arrays = {"attributes": {"POSITION": glb.array(corners)}, "indices": glb.array(faces.reshape(-1))}
    glb.node(name, matrix, mesh=glb.add("meshes", {"primitives": [arrays | {"material": material}]}))


def _outline(is_round: bool) -> np.ndarray:
    """Return corners [n, 3], counter-clockwise from above, within -1 and 1."""
    if not is_round:
        return np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64)
    angles = np.arange(_CORNERS) * (2 * math.pi / _CORNERS)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(_CORNERS)], axis=1)

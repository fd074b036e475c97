"""Lights: points, spots and suns as glTF has them, areas as surfaces that emit."""

from __future__ import annotations

import math

import numpy as np

from .glb import Glb
from .left_out import LeftOut
from .nodes import constant, surface_of, tree_of

#: glTF counts in candela and lux, which are so many to the watt, as Blender's exporter has it.
_LUMENS_PER_WATT = 683.0
#: Corners of a disk.
_CORNERS = 24

_KINDS = {"POINT": "point", "SPOT": "spot", "SUN": "directional"}


def add_light(glb: Glb, light, name: str, matrix: np.ndarray, left_out: LeftOut) -> None:
    """A `bpy.types.Light`, where `matrix` [4, 4] has it."""
    if not light.use_shadow:
        left_out.add("Lights without shadows cast them", name)
    watts = _watts(light, matrix) * _by_nodes(light, name, left_out)
    if not watts.any():
        return
    if light.type == "AREA":
        _add_area(glb, light, name, matrix, watts, left_out)
        return
    strength = _LUMENS_PER_WATT * (watts if light.type == "SUN" else watts / (4 * math.pi))
    brightest = float(strength.max())
    entry = {"type": _KINDS[light.type], "color": (strength / brightest).tolist(), "intensity": brightest}
    if light.type == "SPOT":
        outer = light.spot_size / 2
        entry["spot"] = {"outerConeAngle": outer, "innerConeAngle": outer * (1 - light.spot_blend)}
    glb.node(name, matrix, extensions=glb.light(entry))


def _watts(light, matrix: np.ndarray) -> np.ndarray:
    """[3] of each colour; of a sun watts per square metre."""
    colour = np.array(light.color, np.float64)
    if getattr(light, "use_temperature", False):  # this and what follows: since Blender 4.5
        colour *= np.array(light.temperature_color)
    energy = light.energy * 2.0 ** getattr(light, "exposure", 0.0)
    if not getattr(light, "normalize", True):
        from mathutils import Matrix

        energy *= light.area(matrix_world=Matrix(matrix.tolist()))
    return np.maximum(energy * colour, 0.0)


def _by_nodes(light, name: str, left_out: LeftOut) -> np.ndarray:
    """[3] that its nodes multiply a light by."""
    if tree_of(light) is None:
        return np.ones(3)
    shader = surface_of(light)
    if shader is not None and shader.type == "EMISSION":
        colour, strength = (constant(shader.inputs[key]) for key in ("Color", "Strength"))
        if colour is not None and strength is not None:
            return np.array(colour)[:3] * strength
    left_out.add("Nodes of lights are left out", name)
    return np.ones(3)


def _add_area(glb: Glb, light, name: str, matrix: np.ndarray, watts: np.ndarray, left_out: LeftOut) -> None:
    """White and dull where it does not emit, like the lights that networks are trained with."""
    width = light.size
    height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else width
    corners = _outline(light.shape in ("DISK", "ELLIPSE")) * (width / 2, height / 2, 1.0)
    faces = np.array([(0, i, i - 1) for i in range(2, len(corners))], np.uint32)  # facing -Z, where it shines
    a, b, c = np.moveaxis((corners @ matrix[:3, :3].T)[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2
    if not area > 0:
        left_out.add("Area lights without an area are left out", name)
        return
    left_out.add("Area lights shine to both sides", name)
    radiance = watts / (math.pi * area)
    brightest = float(radiance.max())
    material = {
        "name": name,
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "emissiveFactor": (radiance / brightest).tolist(),
        "extensions": {
            "KHR_materials_specular": {"specularFactor": 0.0},
            "KHR_materials_emissive_strength": {"emissiveStrength": brightest},
        },
    }
    primitive = {
        "attributes": {"POSITION": glb.array(corners)},
        "indices": glb.array(faces.reshape(-1)),
        "material": glb.add("materials", material),
    }
    glb.node(name, matrix, mesh=glb.add("meshes", {"primitives": [primitive]}))


def _outline(is_round: bool) -> np.ndarray:
    """[n, 3] counter-clockwise from above, within -1 and 1."""
    if not is_round:
        return np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64)
    angles = np.arange(_CORNERS) * (2 * math.pi / _CORNERS)
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(_CORNERS)], axis=1)

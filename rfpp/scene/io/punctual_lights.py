"""Emissive triangles in place of lights without extent.

- Point light: an icosahedron of radius 0.02 and radiance 4 · intensity / surface; exact in the mean over directions,
  within 5% in each. Those that would touch are one, because they would block each other.
- Spot light: a disk that shines from a black shade. None of it is seen beyond the outer cone, and half of it where the
  cosine is the mean of the cones', as renderers have it that interpolate by smoothstep. The power is theirs; within the
  cone, irradiance falls off as a cosine.
- Directional light: one triangle with edges of 1.6, 24 from the origin and facing it, with radiance irradiance · 24²
  / area; exact at the origin, within 5% in the box of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from trimesh.creation import icosahedron

from rfpp.scene.io.imported_scene import Part, PunctualLight

_LAMP_RADIUS, _SUN_EDGE, _SUN_DISTANCE = 0.02, 1.6, 24.0

#: Greatest radius and length of a shade.
_SHADE_RADIUS, _SHADE_LENGTH = 0.04, 0.1
#: Limits of the outer cone, and of the disk's radius relative to the opening's: smaller disks need too much radiance.
_NARROWEST, _WIDEST, _SMALLEST_DISK = math.radians(3), math.radians(80), 0.05
_CORNERS = 12


def separate(lights: Sequence[PunctualLight]) -> list[PunctualLight]:
    """Return the lights with point lights that would touch joined to the strongest of them."""
    points = sorted((light for light in lights if light.kind == "point"), key=lambda light: -light.strength.sum())
    apart = [light for light in lights if light.kind != "point"]
    if not points:
        return apart
    tree, is_joined = cKDTree([light.position for light in points]), np.zeros(len(points), bool)
    for number, light in enumerate(points):
        if not is_joined[number]:
            near = tree.query_ball_point(light.position, 2 * _LAMP_RADIUS)
            together = [other for other in near if not is_joined[other]]
            is_joined[together] = True
            apart.append(replace(light, strength=sum(points[other].strength for other in together)))
    return apart


def fixture(light: PunctualLight) -> tuple[Part, ...]:
    """Return the surfaces that replace a light: what emits, and the shade of a spot light."""
    if light.kind == "point":
        lamp = icosahedron()
        vertices, surface = _LAMP_RADIUS * lamp.vertices, _LAMP_RADIUS**2 * lamp.area
        emitter = _emitter(light.name, light.position + vertices, lamp.faces, 4 * light.strength / surface)
        return (replace(emitter, one_sided=True),)  # or a lamp in a ceiling would light it from inside
    if light.kind == "spot":
        return _shaded_disk(light)
    radiance = light.strength * _SUN_DISTANCE**2 / (np.sqrt(3) / 4 * _SUN_EDGE**2)
    return (facing_triangle(light.name, -_SUN_DISTANCE * light.direction, light.direction, _SUN_EDGE, radiance),)


def facing_triangle(
    name: str, center: Float[np.ndarray, 3], normal: Float[np.ndarray, 3], edge: float, radiance: Float[np.ndarray, 3]
) -> Part:
    """Return an equilateral triangle that shines in the direction of its normal alone."""
    corners = center + edge / np.sqrt(3) * _ring(normal, 3)
    return replace(_emitter(name, corners, np.array([[0, 1, 2]]), radiance), one_sided=True)


def _shaded_disk(light: PunctualLight) -> tuple[Part, Part]:
    inner, outer = (math.cos(min(angle, _WIDEST)) for angle in (light.cone[0], max(light.cone[1], _NARROWEST)))
    half, edge = (math.tan(math.acos(cosine)) for cosine in ((inner + outer) / 2, outer))
    length = min(_SHADE_LENGTH, _SHADE_RADIUS / half)
    opening = length * half
    disk = max(length * (edge - half), _SMALLEST_DISK * opening)
    ring = _ring(light.direction, _CORNERS) * math.sqrt(2 * math.pi / _CORNERS / math.sin(2 * math.pi / _CORNERS))
    back, front = light.position - length / 10 * light.direction, light.position + length * light.direction
    here, following = np.arange(_CORNERS), np.roll(np.arange(_CORNERS), -1)
    fan = np.stack([np.full(_CORNERS - 2, 0), here[1:-1], here[2:]], axis=1)
    # A cosine emitter of this radiance and a spot light send the same power through the opening.
    radiance = 2 * light.strength / (math.pi * disk**2 * (1 + (inner + outer) / 2))
    sides = [(here, following, here + _CORNERS), (following, following + _CORNERS, here + _CORNERS)]
    shade = Part(
        f"{light.name}_shade",
        np.concatenate([back + 1.05 * disk * ring, front + opening * ring]),  # around the disk: no gap lets light out
        np.concatenate([np.stack(corners, axis=1) for corners in sides]),
        np.tile(np.array([0, 0, 0, 0, 0, 0, 1, 0, 0, 0], np.float32), (2 * _CORNERS, 1)),
        smooth=False,
    )
    return replace(_emitter(light.name, light.position + disk * ring, fan, radiance), one_sided=True), shade


def _ring(normal: Float[np.ndarray, 3], count: int) -> Float[np.ndarray, "n 3"]:
    """Return points on the unit circle about the normal, counter-clockwise seen from where it points."""
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    aside /= np.linalg.norm(aside)
    angles = (2 * np.pi / count * np.arange(count))[:, None]
    return np.cos(angles) * aside + np.sin(angles) * np.cross(normal, aside)


def _emitter(name: str, vertices: np.ndarray, faces: np.ndarray, radiance: np.ndarray) -> Part:
    row = np.array([1, 1, 1, 0, 0, 0, 1, *radiance], np.float32)  # white and diffuse, as in training scenes
    return Part(name, vertices, faces, np.tile(row, (len(faces), 1)), smooth=False)

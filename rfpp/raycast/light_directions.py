"""Directions from a point to a light, drawn by the light's irradiance there, and their densities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rfpp.raycast.compiled import compiled
from rfpp.raycast.embree import blocked
from rfpp.raycast.lit_scene import CLEARANCE, LitScene, light_of
from rfpp.raycast.polygon_light import of_triangle
from rfpp.raycast.solid_angle import direction_within, solid_angle
from rfpp.raycast.vectors import Vector, dot, mean

#: Solid angle up to which a triangle is sampled by area, in steradians: a sphere's triangle that small is flat.
SMALL_ANGLE = 1e-5


class LightTarget(NamedTuple):
    """A light as a point sees it.

    Attributes:
        sides: A bit for each triangle of a solid light that faces the point; -1 for other lights.
        irradiance: Unoccluded irradiance / π of the light's mean radiance; 0 for lights that are not exact.
    """

    sides: int
    irradiance: float


@compiled
def light_sample(
    scene: LitScene, light: int, target: LightTarget, point: Vector, normal: Vector, u: float, v: float
) -> tuple[int, Vector, float, float, bool]:
    """Draw a direction to a light.

    Triangles of an exact light are chosen by their unoccluded irradiance and sampled by solid angle, so that the
    irradiance of a sample stays bounded beside a light. Others are sampled by emitted power.

    Args:
        target: Result of `target_of`, for the same point.
        normal: Its unit normal.

    Returns:
        Emitter, direction, density per solid angle, unoccluded irradiance of mean radiance / density, and whether the
        direction is free. The density is 0 if the light does not shine on the point.
    """
    if scene.exact[light]:
        e, rest, probability = _emitter_by_irradiance(scene, light, target, point, normal, u)
    else:
        e, rest, probability = _emitter_at(scene, light, u)
    if probability <= 0:
        return e, normal, 0.0, 0.0, False
    angle = solid_angle(point, scene.corners[e])
    if angle > SMALL_ANGLE:
        direction = direction_within(point, scene.corners[e], rest, v)
        corner, facing = scene.corners[e, 0], scene.facing[e]
        toward = dot(direction, facing)
        away = (corner[0] - point[0], corner[1] - point[1], corner[2] - point[2])
        distance = dot(away, facing) / toward if toward != 0 else 0.0
        density = probability / angle
    else:
        root = np.sqrt(min(max(rest, 0.0), 1.0))
        to_a, to_b, to_c = 1 - root, root * (1 - v), root * v
        a, b, c = scene.corners[e]
        x = to_a * a[0] + to_b * b[0] + to_c * c[0] - point[0]
        y = to_a * a[1] + to_b * b[1] + to_c * c[1] - point[1]
        z = to_a * a[2] + to_b * b[2] + to_c * c[2] - point[2]
        distance = np.sqrt(x * x + y * y + z * z)
        direction = (x / distance, y / distance, z / distance)
        density = probability * _density_by_area(scene, e, direction, distance)
    radiance = scene.radiance[e]
    if scene.one_sided[e] and dot(direction, scene.facing[e]) >= 0:
        return e, direction, density, 0.0, False
    arriving = (radiance[0] + radiance[1] + radiance[2]) / 3 * max(dot(direction, normal), 0.0) / density
    clear = arriving > 0 and distance > 0 and not blocked(scene.address, point, direction, distance - CLEARANCE)
    return e, direction, density, arriving, clear


@compiled
def density_of(scene: LitScene, e: int, point: Vector, normal: Vector, direction: Vector, distance: float) -> float:
    """Return the density per solid angle with which `light_sample` draws a direction that hits an emitter."""
    light, probability = light_of(scene, e), scene.share[e]
    if scene.exact[light]:
        target = target_of(scene, light, point, normal)
        probability = 0.0
        if target.irradiance:
            probability = _irradiance(scene, light, target, point, normal, e) / target.irradiance
    angle = solid_angle(point, scene.corners[e])
    within = 1 / angle if angle > SMALL_ANGLE else _density_by_area(scene, e, direction, distance)
    density: float = probability * within
    return density


@compiled
def target_of(scene: LitScene, light: int, point: Vector, normal: Vector) -> LightTarget:
    """Return the sides of a light that face a point and, for an exact light, its unoccluded irradiance there."""
    sides, total = -1, 0.0
    if not scene.exact[light]:
        return LightTarget(sides, total)
    first = scene.first[light]
    if scene.solid[light]:
        sides = 0
        for side in range(scene.first[light + 1] - first):
            if _faces(scene, first + side, point):
                sides |= 1 << side
    target = LightTarget(sides, 0.0)
    for e in range(first, scene.first[light + 1]):
        total += _irradiance(scene, light, target, point, normal, e)
    return LightTarget(sides, total)


@compiled
def _faces(scene: LitScene, e: int, point: Vector) -> bool:
    corner, facing = scene.corners[e, 0], scene.facing[e]
    x, y, z = point[0] - corner[0], point[1] - corner[1], point[2] - corner[2]
    return bool(x * facing[0] + y * facing[1] + z * facing[2] > 0)


@compiled
def _irradiance(scene: LitScene, light: int, target: LightTarget, point: Vector, normal: Vector, e: int) -> float:
    """Return the unoccluded irradiance / π of one triangle's mean radiance."""
    if scene.solid[light] and not (target.sides >> (e - scene.first[light])) & 1:
        return 0.0
    if scene.one_sided[e] and not _faces(scene, e, point):
        return 0.0
    return of_triangle(point, normal, scene.corners[e]) * mean(scene.radiance[e])


@compiled
def _emitter_by_irradiance(
    scene: LitScene, light: int, target: LightTarget, point: Vector, normal: Vector, u: float
) -> tuple[int, float, float]:
    """Choose a triangle of an exact light by its irradiance: triangle, a number uniform again, and probability."""
    found, rest, probability = scene.first[light], 0.0, 0.0
    if target.irradiance <= 0:
        return found, rest, probability
    left = u * target.irradiance
    for e in range(scene.first[light], scene.first[light + 1]):
        own = _irradiance(scene, light, target, point, normal, e)
        if own > 0:
            found, rest, probability = e, min(left / own, 1.0), own / target.irradiance
            if left < own:
                break
            left -= own
    return found, rest, probability


@compiled
def _density_by_area(scene: LitScene, e: int, direction: Vector, distance: float) -> float:
    """Return the density per solid angle of points spread evenly over a triangle."""
    density: float = distance * distance / (scene.area[e] * max(abs(dot(direction, scene.facing[e])), 1e-30))
    return density


@compiled
def _emitter_at(scene: LitScene, light: int, u: float) -> tuple[int, float, float]:
    """Choose a triangle of a light by its power: triangle, a number uniform again, and probability."""
    low: int = scene.first[light]
    high: int = scene.first[light + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if scene.steps[middle] > u:
            high = middle
        else:
            low = middle + 1
    before = scene.steps[low - 1] if low > scene.first[light] else 0.0
    return low, (u - before) / (scene.steps[low] - before), scene.share[low]

"""Direct light at points, in loops that draw, cast and shade one ray after the other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled
from rfpp.raycast.counted_random import Key, key_of, spread, uniform
from rfpp.raycast.embree import blocked
from rfpp.raycast.ggx import lobe_and_pdf, sampled
from rfpp.raycast.lit_scene import CLEARANCE, LitScene, intersect, light_of, tinted
from rfpp.raycast.polygon_light import of_triangle
from rfpp.raycast.solid_angle import direction_within, solid_angle
from rfpp.raycast.surface import Points
from rfpp.raycast.vectors import BLACK, Triple, Vector, added, dot, in_frame, in_world, mean, scaled, tangents, triple

#: Lobes wider than this α find emitters by samples of the lights alone.
WIDE = 0.1
#: Lights that each of many rays samples where it ends.
_AT_ONCE = 4
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
def over_density(own: float, other: float) -> float:
    """Return the weight of a sample that another density could have drawn too, over its own density.

    The weight is the power heuristic own² / (own² + other²) (Veach 1997): samples of the lobe dominate for sharp lobes,
    which samples of the light hit rarely.
    """
    return own / (own * own + other * other)


@compiled
def draw_lobe(
    view: Vector, alpha: float, u: float, v: float, first: Vector, second: Vector, normal: Vector
) -> tuple[Triple, Triple]:
    """Draw a direction from the glossy lobe; return it in the frame of tangents and normal, and in world space."""
    toward = sampled(view, alpha, u, v)
    return toward, in_world(toward, first, second, normal)


@compiled
def emitter_light(
    scene: LitScene,
    emitter: int,
    point: Vector,
    normal: Vector,
    direction: Vector,
    distance: float,
    view: Vector,
    toward: Vector,
    alpha: float,
) -> Triple:
    """Return the light of an emitter hit by a ray of the lobe, uncolored and for single scattering."""
    light = light_of(scene, emitter)
    if not scene.shining[light] or (scene.one_sided[emitter] and dot(direction, scene.facing[emitter]) >= 0):
        return BLACK
    reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
    density = density_of(scene, emitter, point, normal, direction, distance)
    return scaled(triple(scene.radiance[emitter]), reflected * over_density(by_lobe, density))


@compiled
def rays_to_all(scene: LitScene) -> int:
    """Return the number of rays that together sample all lights at their ends."""
    return max((len(scene.shining) + _AT_ONCE - 1) // _AT_ONCE, 1)


@compiled
def direct_at(
    scene: LitScene,
    point: Vector,
    normal: Vector,
    view: Vector,
    alpha: float,
    specular: Vector,
    samples: int,
    key: Key,
    wants_diffuse: bool,
    every: int,
    turn: int,
) -> tuple[Triple, Triple]:
    """Return irradiance / π and glossy light at a point, in the units of `DirectLight`.

    Args:
        alpha: α of the glossy lobe; negative if there is none.
        specular: Specular albedo, which colors multiple scattering.
        wants_diffuse: Compute irradiance; else it is 0.
        every, turn: Sample every `every`th light, beginning with number `turn`, in place of all. The choice does not
            depend on which lights shine, so that the light of several is the sum of theirs.
    """
    diffuse, glossy = BLACK, BLACK
    first, second = tangents(normal)
    view = in_frame(view, first, second, normal)
    for light in range(len(scene.shining)):
        if not scene.shining[light] or (light + turn) % every != 0:
            continue
        shift_u, shift_v = uniform(key, 2 * light), uniform(key, 2 * light + 1)
        target = target_of(scene, light, point, normal)
        for s in range(samples):
            u, v = spread(s, shift_u, shift_v)
            e, direction, density, _, clear = light_sample(scene, light, target, point, normal, u, v)
            if not clear:
                continue
            toward, radiance = in_frame(direction, first, second, normal), triple(scene.radiance[e])
            if wants_diffuse:
                diffuse = added(diffuse, scaled(radiance, toward[2] / density / (np.pi * samples)))
            if alpha >= 0:
                reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
                weight = reflected * (1 / density if alpha > WIDE else over_density(density, by_lobe)) / samples
                glossy = added(glossy, scaled(radiance, weight))
    diffuse, glossy = scaled(diffuse, every), scaled(glossy, every)
    if alpha < 0:
        return diffuse, glossy
    if alpha <= WIDE and len(scene.shining) > 0:
        toward, direction = draw_lobe(view, alpha, uniform(key, -1), uniform(key, -2), first, second, normal)
        if toward[2] > 0:
            triangle, _, _, distance, _ = intersect(scene, point, direction)
            if triangle >= 0 and scene.emitter[triangle] >= 0:
                found = emitter_light(
                    scene, scene.emitter[triangle], point, normal, direction, distance, view, toward, alpha
                )
                glossy = added(glossy, found)
    return diffuse, tinted(scene, glossy, view[2], alpha, specular)


@compiled
def gathered_each(
    start: int,
    stop: int,
    scene: LitScene,
    points: Points,
    samples: int,
    key: Key,
    diffuse: Float[np.ndarray, "r 3"],
    glossy: Float[np.ndarray, "r 3"],
) -> None:
    """Fill in the direct light at points."""
    for row in range(start, stop):
        normal, view = triple(points.normal[row]), triple(points.eye[row])
        shines = max(points.specular[row, 0], points.specular[row, 1], points.specular[row, 2]) > 0
        alpha = points.alpha[row] if shines and dot(normal, view) > 0 else -1.0
        point, specular, own_key = triple(points.point[row]), triple(points.specular[row]), key_of(key, row)
        found = direct_at(scene, point, normal, view, alpha, specular, samples, own_key, True, 1, 0)
        for c in range(3):
            diffuse[row, c], glossy[row, c] = found[0][c], found[1][c]


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

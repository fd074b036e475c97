"""Direct light at points, in loops that draw, cast and shade one ray after the other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled
from rfpp.raycast.counted_random import Key, key_of, spread, uniform
from rfpp.raycast.ggx import lobe_and_pdf, sampled
from rfpp.raycast.light_directions import density_of, light_sample, target_of
from rfpp.raycast.lit_scene import LitScene, intersect, light_of, tinted
from rfpp.raycast.surface import Points
from rfpp.raycast.vectors import BLACK, Triple, Vector, added, dot, in_frame, in_world, scaled, tangents, triple

#: Lobes wider than this α find emitters by samples of the lights alone.
WIDE = 0.1
#: Lights that each of many rays samples where it ends, and that each of many points gathers.
_AT_ONCE, _OF_POINT = 4, 32


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
    """Fill in the direct light at points; points take turns with many lights."""
    every = max(len(scene.shining) // _OF_POINT, 1)
    for row in range(start, stop):
        normal, view = triple(points.normal[row]), triple(points.eye[row])
        shines = max(points.specular[row, 0], points.specular[row, 1], points.specular[row, 2]) > 0
        alpha = points.alpha[row] if shines and dot(normal, view) > 0 else -1.0
        point, specular, own_key = triple(points.point[row]), triple(points.specular[row]), key_of(key, row)
        found = direct_at(scene, point, normal, view, alpha, specular, samples, own_key, True, every, row)
        for c in range(3):
            diffuse[row, c], glossy[row, c] = found[0][c], found[1][c]

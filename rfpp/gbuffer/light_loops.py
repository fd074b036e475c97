"""Light that reaches a point straight from the emitters, in loops that make, cast and shade one ray after the other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.counted_random import Key, key_of, spread, uniform
from rfpp.gbuffer.embree import Ray, blocked, new_ray
from rfpp.gbuffer.ggx import lobe_and_pdf, sampled
from rfpp.gbuffer.lit_scene import CLEARANCE, LitScene, light_of, met, scattering
from rfpp.gbuffer.polygon_light import of_triangle
from rfpp.gbuffer.surface import Points
from rfpp.gbuffer.vectors import Triple, Vector, dot, in_frame, in_world, tangents, triple

#: Lobes wider than this α find emitters by samples of the lights alone.
WIDE = 0.1


@compiled
def light_sample(
    scene: LitScene, ray: Ray, light: int, point: Vector, normal: Vector, u: float, v: float
) -> tuple[int, Triple, float, float, bool]:
    """A point of a light: its emitter, direction, density per solid angle, what would arrive of the mean radiance with
    nothing in between, and whether nothing is."""
    e = _emitter_at(scene, light, u)
    # what is left of the number within its step is uniform again
    before = scene.steps[e - 1] if e > scene.first[light] else 0.0
    root = np.sqrt(min(max((u - before) / (scene.steps[e] - before), 0.0), 1.0))
    to_a, to_b, to_c = 1 - root, root * (1 - v), root * v
    a, b, c = scene.corners[e]
    x = to_a * a[0] + to_b * b[0] + to_c * c[0] - point[0]
    y = to_a * a[1] + to_b * b[1] + to_c * c[1] - point[1]
    z = to_a * a[2] + to_b * b[2] + to_c * c[2] - point[2]
    distance = np.sqrt(x * x + y * y + z * z)
    way = (x / distance, y / distance, z / distance)
    density, radiance = density_of(scene, e, way, distance), scene.radiance[e]
    arriving = (radiance[0] + radiance[1] + radiance[2]) / 3 * max(dot(way, normal), 0.0) / density
    clear = arriving > 0 and not blocked(scene.address, ray, point, way, distance - CLEARANCE)
    return e, way, density, arriving, clear


@compiled
def density_of(scene: LitScene, e: int, way: Vector, distance: float) -> float:
    """Of samples of its light, per solid angle, at a point of an emitter; infinite for one seen edge-on."""
    density: float = scene.density[e]
    return density * distance * distance / abs(dot(way, scene.facing[e]))


@compiled
def by_formula(
    scene: LitScene, light: int, point: Vector, normal: Vector, share: float, diffuse: Float[np.ndarray, " 3"]
) -> None:
    """Adds irradiance / π of a light of which a share is in sight, by Lambert's formula."""
    for e in range(scene.first[light], scene.first[light + 1]):
        factor = of_triangle(point, normal, scene.corners[e]) * share
        for c in range(3):
            diffuse[c] += scene.radiance[e, c] * factor


@compiled
def over_density(own: float, other: float) -> float:
    """1 / own density, times the weight of a sample that the other way of sampling could have given too.

    The power heuristic own² / (own² + other²) (Veach 1997): a sharp lobe is left to its own samples, which see the
    light whole, where light samples would hit the lobe now and then and sparkle.
    """
    return own / (own * own + other * other)


@compiled
def along_lobe(
    view: Vector, alpha: float, u: float, v: float, first: Vector, second: Vector, normal: Vector
) -> tuple[Triple, Triple]:
    """A direction that the glossy lobe samples: in the frame of two tangents and the normal, and in the world."""
    toward = sampled(view, alpha, u, v)
    return toward, in_world(toward, first, second, normal)


@compiled
def emitter_light(
    scene: LitScene,
    emitter: int,
    way: Vector,
    distance: float,
    view: Vector,
    toward: Vector,
    alpha: float,
    glossy: Float[np.ndarray, " 3"],
) -> None:
    """Adds what a ray of the lobe that has met an emitter brings, untinted and of single scattering."""
    if not scene.shining[light_of(scene, emitter)]:
        return
    reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
    weight = reflected * over_density(by_lobe, density_of(scene, emitter, way, distance))
    for c in range(3):
        glossy[c] += weight * scene.radiance[emitter, c]


@compiled
def direct_at(
    scene: LitScene,
    ray: Ray,
    point: Vector,
    normal: Vector,
    view: Vector,
    alpha: float,
    specular: Vector,
    samples: int,
    key: Key,
    wants_diffuse: bool,
    diffuse: Float[np.ndarray, " 3"],
    glossy: Float[np.ndarray, " 3"],
) -> None:
    """Sets irradiance / π and glossy light at a point, in the units of `DirectLight`.

    Args:
        view: towards the eye.
        alpha: negative for a surface without glossy lobe.
        specular: albedo, by which multiple scattering is coloured.
        samples: shadow rays to each light.
        wants_diffuse: whether irradiance is of interest.
        diffuse, glossy: [3].
    """
    diffuse[:], glossy[:] = 0.0, 0.0
    first, second = tangents(normal)
    view = in_frame(view, first, second, normal)
    for light in range(len(scene.shining)):
        if not scene.shining[light]:
            continue
        shift_u, shift_v = uniform(key, 2 * light), uniform(key, 2 * light + 1)
        visible, whole, exact = 0.0, 0.0, scene.exact[light]
        for s in range(samples):
            u, v = spread(s, shift_u, shift_v)
            e, way, density, arriving, clear = light_sample(scene, ray, light, point, normal, u, v)
            whole += arriving
            if not clear:
                continue
            visible += arriving
            toward = in_frame(way, first, second, normal)
            for c in range(3):
                diffuse[c] += 0.0 if exact else toward[2] / density / (np.pi * samples) * scene.radiance[e, c]
            if alpha >= 0:
                reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
                weight = reflected * (1 / density if alpha > WIDE else over_density(density, by_lobe)) / samples
                for c in range(3):
                    glossy[c] += weight * scene.radiance[e, c]
        if wants_diffuse and exact and visible > 0:
            by_formula(scene, light, point, normal, visible / whole, diffuse)
    if alpha < 0:
        return
    if alpha <= WIDE and len(scene.shining) > 0:
        toward, way = along_lobe(view, alpha, uniform(key, -1), uniform(key, -2), first, second, normal)
        if toward[2] > 0:
            triangle, _, _, distance, _ = met(scene, ray, point, way)
            if triangle >= 0 and scene.emitter[triangle] >= 0:
                emitter_light(scene, scene.emitter[triangle], way, distance, view, toward, alpha, glossy)
    for c in range(3):
        glossy[c] *= scattering(scene, view[2], alpha, specular[c])


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
    """Direct light at points.

    Args:
        points: a `Surface`'s arrays (`rfpp.gbuffer.surface.Points`).
        diffuse, glossy: [R, 3] to fill in.
    """
    ray = new_ray()
    for row in range(start, stop):
        normal, view = triple(points.normal[row]), triple(points.eye[row])
        shines = max(points.specular[row, 0], points.specular[row, 1], points.specular[row, 2]) > 0
        alpha = points.alpha[row] if shines and dot(normal, view) > 0 else -1.0
        point, specular, own_key = triple(points.point[row]), triple(points.specular[row]), key_of(key, row)
        direct_at(scene, ray, point, normal, view, alpha, specular, samples, own_key, True, diffuse[row], glossy[row])


@compiled
def _emitter_at(scene: LitScene, light: int, u: float) -> int:
    """The emitter of a light whose step a number lies in."""
    low: int = scene.first[light]
    high: int = scene.first[light + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if scene.steps[middle] > u:
            high = middle
        else:
            low = middle + 1
    return low

"""Light that reaches a point straight from the emitters, in loops that make, cast and shade one ray after the other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled, float64
from rfpp.raycast.counted_random import Key, key_of, spread, uniform
from rfpp.raycast.embree import blocked
from rfpp.raycast.ggx import lobe_and_pdf, sampled
from rfpp.raycast.lit_scene import CLEARANCE, LitScene, light_of, met, tinted
from rfpp.raycast.polygon_light import of_triangle
from rfpp.raycast.surface import Points
from rfpp.raycast.vectors import BLACK, Triple, Vector, added, dot, in_frame, in_world, scaled, tangents, triple

#: Lobes wider than this α find emitters by samples of the lights alone.
WIDE = 0.1
#: Lights that each of many rays samples where it ends.
_AT_ONCE = 4
#: See `sides_facing`.
Sides = tuple[int, float]


@compiled
def light_sample(
    scene: LitScene, light: int, sides: Sides, point: Vector, normal: Vector, u: float, v: float
) -> tuple[int, Triple, float, float, bool]:
    """A point of a light: its emitter, direction, density per solid angle, what would arrive of the mean radiance with
    nothing in between, and whether nothing is.

    Args:
        sides: of the light, that face the point: see `sides_facing`.
    """
    share = sides[1]
    e, rest = _facing_emitter(scene, light, sides[0], u * share) if share < 1 else _emitter_at(scene, light, u)
    root = np.sqrt(min(max(rest, 0.0), 1.0))
    to_a, to_b, to_c = 1 - root, root * (1 - v), root * v
    a, b, c = scene.corners[e]
    x = to_a * a[0] + to_b * b[0] + to_c * c[0] - point[0]
    y = to_a * a[1] + to_b * b[1] + to_c * c[1] - point[1]
    z = to_a * a[2] + to_b * b[2] + to_c * c[2] - point[2]
    distance = np.sqrt(x * x + y * y + z * z)
    way = (x / distance, y / distance, z / distance)
    density, radiance = density_of(scene, e, way, distance) / share, scene.radiance[e]
    arriving = (radiance[0] + radiance[1] + radiance[2]) / 3 * max(dot(way, normal), 0.0) / density
    clear = arriving > 0 and not blocked(scene.address, point, way, distance - CLEARANCE)
    return e, way, density, arriving, clear


@compiled
def density_of(scene: LitScene, e: int, way: Vector, distance: float) -> float:
    """Of samples of its light, per solid angle, at a point of an emitter; infinite for one seen edge-on."""
    density: float = scene.density[e]
    return density * distance * distance / abs(dot(way, scene.facing[e]))


@compiled
def sides_facing(scene: LitScene, light: int, point: Vector) -> Sides:
    """The sides of a light towards a point, which alone are sampled: a bit for each, and their share of its samples.

    All of them (-1, 1) unless the light is solid, and where none face a point within it.
    """
    bits, share = 0, 0.0
    if scene.solid[light]:
        first = scene.first[light]
        for side in range(scene.first[light + 1] - first):
            if _faces(scene, first + side, point):
                bits |= 1 << side
                share += _share_of(scene, light, first + side)
    return (bits, share) if share > 0 else (-1, 1.0)


@compiled
def by_formula(scene: LitScene, light: int, sides: Sides, point: Vector, normal: Vector, share: float) -> Triple:
    """Irradiance / π of a light of which a share is in sight, by Lambert's formula."""
    arriving, bits = BLACK, sides[0]
    for e in range(scene.first[light], scene.first[light + 1]):
        if bits & 1:
            factor = of_triangle(point, normal, scene.corners[e]) * share
            arriving = added(arriving, scaled(triple(scene.radiance[e]), factor))
        bits >>= 1
    return arriving


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
    point: Vector,
    way: Vector,
    distance: float,
    view: Vector,
    toward: Vector,
    alpha: float,
) -> Triple:
    """What a ray of the lobe that has met an emitter brings, untinted and of single scattering."""
    light = light_of(scene, emitter)
    if not scene.shining[light]:
        return BLACK
    reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
    density = density_of(scene, emitter, way, distance) / sides_facing(scene, light, point)[1]
    return scaled(triple(scene.radiance[emitter]), reflected * over_density(by_lobe, density))


@compiled
def rays_to_all(scene: LitScene) -> int:
    """How many rays that gather together it takes to sample all lights where they end."""
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
    """Irradiance / π and glossy light at a point, in the units of `DirectLight`.

    Args:
        view: towards the eye.
        alpha: negative for a surface without glossy lobe.
        specular: albedo, by which multiple scattering is coloured.
        samples: shadow rays to each light.
        wants_diffuse: whether irradiance is of interest.
        every, turn: of the lights each `every`th from this one on is sampled, for all of them. Which, does not depend
            on what shines, so that the light of several is the sum of theirs.
    """
    diffuse, glossy = BLACK, BLACK
    first, second = tangents(normal)
    view = in_frame(view, first, second, normal)
    for light in range(len(scene.shining)):
        if not scene.shining[light] or (light + turn) % every != 0:
            continue
        shift_u, shift_v = uniform(key, 2 * light), uniform(key, 2 * light + 1)
        sides, exact, visible, whole = sides_facing(scene, light, point), scene.exact[light], 0.0, 0.0
        for s in range(samples):
            u, v = spread(s, shift_u, shift_v)
            e, way, density, arriving, clear = light_sample(scene, light, sides, point, normal, u, v)
            whole += arriving
            if not clear:
                continue
            visible += arriving
            toward, radiance = in_frame(way, first, second, normal), triple(scene.radiance[e])
            if not exact:
                diffuse = added(diffuse, scaled(radiance, toward[2] / density / (np.pi * samples)))
            if alpha >= 0:
                reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
                weight = reflected * (1 / density if alpha > WIDE else over_density(density, by_lobe)) / samples
                glossy = added(glossy, scaled(radiance, weight))
        if wants_diffuse and exact and visible > 0:
            diffuse = added(diffuse, by_formula(scene, light, sides, point, normal, visible / whole))
    diffuse, glossy = scaled(diffuse, every), scaled(glossy, every)
    if alpha < 0:
        return diffuse, glossy
    if alpha <= WIDE and len(scene.shining) > 0:
        toward, way = along_lobe(view, alpha, uniform(key, -1), uniform(key, -2), first, second, normal)
        if toward[2] > 0:
            triangle, _, _, distance, _ = met(scene, point, way)
            if triangle >= 0 and scene.emitter[triangle] >= 0:
                found = emitter_light(scene, scene.emitter[triangle], point, way, distance, view, toward, alpha)
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
    """Direct light at points.

    Args:
        points: a `Surface`'s arrays (`rfpp.raycast.surface.Points`).
        diffuse, glossy: [R, 3] to fill in.
    """
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
    """Whether a side of a solid light faces a point."""
    corner, facing = scene.corners[e, 0], scene.facing[e]
    x, y, z = point[0] - corner[0], point[1] - corner[1], point[2] - corner[2]
    return bool(x * facing[0] + y * facing[1] + z * facing[2] > 0)


@compiled
def _share_of(scene: LitScene, light: int, e: int) -> float:
    """That an emitter has of its light's samples."""
    before = scene.steps[e - 1] if e > scene.first[light] else 0.0
    return float64(scene.steps[e] - before)


@compiled
def _facing_emitter(scene: LitScene, light: int, bits: int, u: float) -> tuple[int, float]:
    """The side of a solid light, of those that have a bit, whose step a number lies in, and how far along it."""
    found, rest = scene.first[light], 0.0
    for e in range(scene.first[light], scene.first[light + 1]):
        if bits & 1:
            share = _share_of(scene, light, e)
            found, rest = e, u / share
            if u < share:
                break
            u -= share
        bits >>= 1
    return found, rest


@compiled
def _emitter_at(scene: LitScene, light: int, u: float) -> tuple[int, float]:
    """The emitter of a light whose step a number lies in, and how far along it, which is uniform again."""
    low: int = scene.first[light]
    high: int = scene.first[light + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if scene.steps[middle] > u:
            high = middle
        else:
            low = middle + 1
    before = scene.steps[low - 1] if low > scene.first[light] else 0.0
    return low, (u - before) / (scene.steps[low] - before)

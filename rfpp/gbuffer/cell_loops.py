"""Cells that rays end in, and what the glossy lobe of the surface there sends back along them; see `ray_ends`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer.cell_table import NOWHERE, CellTable, cell_of, key_at
from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.counted_random import Key, key_of, uniform
from rfpp.gbuffer.embree import Ray, new_ray
from rfpp.gbuffer.ggx import lobe_and_pdf
from rfpp.gbuffer.light_loops import along_lobe, direct_at
from rfpp.gbuffer.lit_scene import (
    LitScene,
    alpha_of,
    blurred,
    density_of_lobes,
    growth,
    met,
    scattering,
    surface_there,
)
from rfpp.gbuffer.surface import Points
from rfpp.gbuffer.traces import Trace
from rfpp.gbuffer.vectors import GOLDEN, Triple, Vector, dot, in_frame, in_world, normal_of, tangents, triple

#: Pixels along each side of a tile.
_TILE = 4
#: Numbers under a key: of the ray thrown on, of whether it is, of the light there.
_WAY_U, _WAY_V, _SENT, _LIGHT = 0, 1, 2, 3


@compiled
def followed(
    scene: LitScene,
    table: CellTable,
    ray: Ray,
    origin: Vector,
    way: Vector,
    density: float,
    key: Key,
    light: Float[np.ndarray, "2 3"],
) -> tuple[int, int, int]:
    """What a ray meets: its triangle, its cell, and the cell in which the ray ends that the glossy lobe there throws
    on. In the first row of `light` [2, 3], the radiance of the emitters that comes back by way of that lobe; in the
    second, its derivative by the specular albedo there.

    Onward is NOWHERE in the share in which the lobe, for all that its albedo does not say, sends no light on.

    Args:
        density: per solid angle, with which the surface that the ray leaves sends rays this way.
    """
    light[:] = 0.0
    triangle, a, b, distance, there = met(scene, ray, origin, way)
    if triangle < 0:
        return triangle, NOWHERE, NOWHERE
    cell = _cell_met(scene, table, triangle, way, there)
    specular = triple(scene.material[triangle, 3:6])
    # a ray that starts on another surface, where two touch, ends where it starts: it is not seen from anywhere
    if scene.emitter[triangle] >= 0 or distance <= 0 or max(specular[0], specular[1], specular[2]) <= 0:
        return triangle, cell, NOWHERE
    point, normal, back = surface_there(scene, triangle, a, b, way, there)
    alpha = blurred(alpha_of(scene, triangle), density)
    first, second = tangents(normal)
    view = in_frame(back, first, second, normal)
    if view[2] <= 0:
        return triangle, cell, NOWHERE
    of_light = key_of(key, _LIGHT)
    direct_at(scene, ray, point, normal, back, alpha, specular, 1, of_light, False, light[1], light[0])
    for c in range(3):
        light[1, c] = light[0, c] * (1 + specular[c] * growth(scene, view[2], alpha, specular[c]))
        light[0, c] *= specular[c]
    sent, way = thrown(
        scene, view, alpha, specular, uniform(key, _WAY_U), uniform(key, _WAY_V), uniform(key, _SENT), first, second,
        normal,
    )  # fmt: skip
    if not sent:
        return triangle, cell, NOWHERE
    other, _, _, _, there = met(scene, ray, point, way)
    return triangle, cell, (_cell_met(scene, table, other, way, there) if other >= 0 else NOWHERE)


@compiled
def thrown(
    scene: LitScene,
    view: Vector,
    alpha: float,
    specular: Vector,
    u: float,
    v: float,
    threshold: float,
    first: Vector,
    second: Vector,
    normal: Vector,
) -> tuple[bool, Triple]:
    """Whether the glossy lobe throws a ray, and its direction.

    The lobe absorbs a ray in the share in which it does not send its light on, beside what its albedo says.

    Args:
        view: in the frame of the two tangents and the normal.
    """
    toward, way = along_lobe(view, alpha, u, v, first, second, normal)
    reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
    scale = 0.0
    for c in range(3):
        scale += scattering(scene, view[2], alpha, specular[c]) / 3
    return scale * reflected / max(by_lobe, 1e-30) > threshold, way


@compiled
def follow_each(
    start: int,
    stop: int,
    scene: LitScene,
    table: CellTable,
    origins: Float[np.ndarray, "r 3"],
    ways: Float[np.ndarray, "r 3"],
    density: Float[np.ndarray, " r"],
    key: Key,
    cell: Int[np.ndarray, " r"],
    onward: Int[np.ndarray, " r"],
    light: Float[np.ndarray, "r 3"],
    triangle: Int[np.ndarray, " r"],
    slope: Float[np.ndarray, "r 3"],
) -> None:
    """Rays one by one; see `followed`."""
    ray, found = new_ray(), np.zeros((2, 3))
    for row in range(start, stop):
        of_ray = key_of(key, row)
        triangle[row], cell[row], onward[row] = followed(
            scene, table, ray, triple(origins[row]), triple(ways[row]), density[row], of_ray, found
        )
        light[row], slope[row] = found[0], found[1]


@compiled
def cells_seen(
    start: int,
    stop: int,
    scene: LitScene,
    table: CellTable,
    points: Points,
    point_of: Int[np.ndarray, "pixels of_pixel"],
    width: int,
    key: Key,
    diffuse: Int[np.ndarray, "pixels rays"],
    glossy: Int[np.ndarray, "pixels rays"],
    diffuse_on: Int[np.ndarray, "pixels rays"],
    glossy_on: Int[np.ndarray, "pixels rays"],
    light: Float[np.ndarray, "pixels 3"],
    trace: Trace,
) -> None:
    """The cells that pixels see; see `SeenCells`, whose arrays these fill in.

    Args:
        points: `rfpp.gbuffer.surface.Points`.
        point_of: [pixels, points of each] rows of the points, -1 for none.
        width: of the image in pixels.
        light: [pixels, 3] highlights.
        trace: of `light`, to fill in (`rfpp.gbuffer.traces.Trace`).
    """
    ray, found, traced = new_ray(), np.zeros((2, 3)), trace.triangle.shape[1] > 0
    rays = diffuse.shape[1]
    for pixel in range(start, stop):
        own_key = key_of(key, pixel)
        y, x = pixel // width, pixel % width
        # what a pixel's few rays miss, its neighbours' find: those of a tile's pixels together are one lattice
        of_tile = key_of(key_of(key, -1), y // _TILE * width + x // _TILE)
        place = y % _TILE * _TILE + x % _TILE
        turn = uniform(own_key, -1)
        for s in range(rays):
            row = point_of[pixel, s % points.of_pixel]
            if row < 0:
                continue
            u, v = _of_lattice(place + _TILE * _TILE * s, rays * _TILE * _TILE, of_tile)
            point, normal, alpha = triple(points.point[row]), triple(points.normal[row]), points.alpha[row]
            specular = triple(points.specular[row])
            first, second = tangents(normal)
            view = in_frame(points.eye[row], first, second, normal)
            mean_diffuse = (points.diffuse[row, 0] + points.diffuse[row, 1] + points.diffuse[row, 2]) / 3
            mean_specular = (specular[0] + specular[1] + specular[2]) / 3
            # as dense as diffuse light arrives: points of a disc, lifted (Malley 1988)
            radius, angle = np.sqrt(u), 2 * np.pi * v
            toward = (radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u))
            by_lobe = lobe_and_pdf(view, toward, alpha)[1] if alpha >= 0 else 0.0
            density = density_of_lobes(mean_diffuse, mean_specular, toward[2], by_lobe)
            way = in_world(toward, first, second, normal)
            of_ray = key_of(own_key, 2 * s)
            triangle, diffuse[pixel, s], diffuse_on[pixel, s] = followed(
                scene, table, ray, point, way, density, of_ray, found
            )
            for c in range(3):
                light[pixel, c] += found[0, c] / rays
            if traced and triangle >= 0:
                trace.triangle[pixel, s] = triangle
                for c in range(3):
                    trace.specular[pixel, s, c] = found[1, c] / rays
            if alpha < 0:
                continue
            # each ray of a pixel is absorbed above a threshold of its own
            threshold = (s + turn * rays) % rays / rays
            sent, way = thrown(scene, view, alpha, specular, u, v, threshold, first, second, normal)
            if not sent:
                continue
            toward = in_frame(way, first, second, normal)
            density = density_of_lobes(mean_diffuse, mean_specular, toward[2], lobe_and_pdf(view, toward, alpha)[1])
            _, glossy[pixel, s], glossy_on[pixel, s] = followed(
                scene, table, ray, point, way, density, key_of(own_key, 2 * s + 1), found
            )


@compiled
def _of_lattice(number: int, count: int, key: Key) -> tuple[float, float]:
    """A point of the unit square: one of so many that are spread evenly, displaced."""
    u, v = (number + 0.5) / count + uniform(key, 0), number * GOLDEN + uniform(key, 1)
    return u % 1, v % 1


@compiled
def _cell_met(scene: LitScene, table: CellTable, triangle: int, way: Vector, point: Vector) -> int:
    a, b, c = scene.positions[triangle]
    back = dot(normal_of(triple(a), triple(b), triple(c)), way) > 0
    return cell_of(table, key_at(table, triangle, point, back))

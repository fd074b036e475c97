"""Cells that rays end in, and what the glossy lobe of the surface there sends back along them; see `ray_ends`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer.compiled import compiled, int64
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

#: What a ray's end is called that meets no cell.
NOWHERE = -1
#: Half an object is cut into so many pieces along an axis at most.
MOST_PIECES = 4
#: An object that reaches less far along an axis than this share of its greatest reach is flat.
FLAT = 1e-4
#: Directions of a triangle in its object's axes: forwards or backwards along one of three; and its two sides.
DIRECTIONS, SIDES = 6, 2
#: Keys of an octant.
KEYS_OF_OCTANT = (2 * MOST_PIECES) ** 3 * DIRECTIONS * SIDES
#: Pixels along each side of a tile.
_TILE = 4
#: Numbers under a key: of the ray thrown on, of whether it is, of the light there.
_WAY_U, _WAY_V, _SENT, _LIGHT = 0, 1, 2, 3


class CellTable(NamedTuple):
    """What loops read of a `CellMap`.

    Attributes:
        owner, direction: [M] object of each triangle, and which way it faces in the object's axes.
        centroid, axes, half, pieces: see `CellGrid`.
        keys, cell: ascending, and the cell of each; NOWHERE for those that no light can reach.
        coarse_keys, coarse_cell: of every octant's side, its first.
    """

    owner: Int[np.ndarray, " m"]
    direction: Int[np.ndarray, " m"]
    centroid: Float[np.ndarray, "o 3"]
    axes: Float[np.ndarray, "o 3 3"]
    half: Float[np.ndarray, "o 3"]
    pieces: Int[np.ndarray, "o 3"]
    keys: Int[np.ndarray, " k"]
    cell: Int[np.ndarray, " k"]
    coarse_keys: Int[np.ndarray, " j"]
    coarse_cell: Int[np.ndarray, " j"]


@compiled
def key_at(table: CellTable, triangle: int, point: Vector, back: bool) -> int:
    """A number for the cell of a point on the front or the back of a triangle; the same for the same cell."""
    owner = table.owner[triangle]
    half, pieces, centre = table.half[owner], table.pieces[owner], table.centroid[owner]
    flat = FLAT * max(half[0], half[1], half[2])
    away = (point[0] - centre[0], point[1] - centre[1], point[2] - centre[2])
    octant, box = 0, 0
    for k in range(3):
        place = pieces[k]
        if half[k] >= flat:  # else rounding alone would say on which side a point lies
            place += int64(np.floor(dot(table.axes[owner, k], away) / max(half[k], 1e-9) * pieces[k]))
        place = min(max(place, 0), 2 * pieces[k] - 1)
        octant |= (place >= pieces[k]) << k  # octant first: it is what a token of HOCT stands for
        box = box * 2 * MOST_PIECES + place
    of_box = (owner * 8 + octant) * (2 * MOST_PIECES) ** 3 + box
    key: int = (of_box * DIRECTIONS + table.direction[triangle]) * SIDES + back
    return key


@compiled
def coarse_key(key: int) -> int:
    """A number for octant and side alone."""
    return key // KEYS_OF_OCTANT * SIDES + key % SIDES


@compiled
def cell_of(table: CellTable, key: int) -> int:
    """The cell of a key. Cells so small that none of our points lay there: any of their octant and side."""
    row = _found(table.keys, key)
    if row >= 0:
        cell: int = table.cell[row]
        return cell
    row = _found(table.coarse_keys, coarse_key(key))
    if row < 0:
        return NOWHERE
    coarse: int = table.coarse_cell[row]
    return coarse


@compiled
def keys_each(
    start: int,
    stop: int,
    table: CellTable,
    triangle: Int[np.ndarray, " r"],
    points: Float[np.ndarray, "r 3"],
    back: Bool[np.ndarray, " r"],
    keys: Int[np.ndarray, " r"],
) -> None:
    """Keys of points."""
    for row in range(start, stop):
        keys[row] = key_at(table, triangle[row], triple(points[row]), back[row])


@compiled
def cells_each(
    start: int, stop: int, table: CellTable, keys: Int[np.ndarray, " r"], cell: Int[np.ndarray, " r"]
) -> None:
    """Cells of keys."""
    for row in range(start, stop):
        cell[row] = cell_of(table, keys[row])


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


@compiled
def _found(keys: Int[np.ndarray, " k"], key: int) -> int:
    """Where a key stands among ascending ones; -1 for nowhere."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else -1

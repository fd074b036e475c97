"""Compiled loops that follow rays to the cells in which they end; see `ray_ends`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rfpp.radiosity.cell_table import NOWHERE, CellTable, cell_at
from rfpp.raycast.compiled import compiled, int64
from rfpp.raycast.counted_random import TILE, Key, key_of, tile_of, uniform
from rfpp.raycast.ggx import lobe_and_pdf
from rfpp.raycast.light_loops import direct_at, draw_lobe, rays_to_all
from rfpp.raycast.lit_scene import (
    LitScene,
    alpha_of,
    blurred,
    density_of_lobes,
    intersect,
    scattering,
    slope_of,
    surface_at,
)
from rfpp.raycast.surface import Points
from rfpp.raycast.traces import Trace
from rfpp.raycast.vectors import (
    BLACK,
    GOLDEN,
    Triple,
    Vector,
    added,
    dot,
    in_frame,
    in_world,
    mean,
    normal_of,
    product,
    tangents,
    triple,
)

#: Random numbers of a key: for the continuation, for its absorption, for the light there.
_LOBE_U, _LOBE_V, _ABSORPTION, _LIGHT = 0, 1, 2, 3


class End(NamedTuple):
    """End of a ray.

    Attributes:
        triangle: Triangle hit; -1 if none.
        cell: Cell hit; NOWHERE if none.
        onward: Cell in which the ray's glossy continuation ends; NOWHERE if it escapes or is absorbed.
        light: Radiance towards the ray's origin, as the emitters light the surface there.
        by_diffuse, by_specular: Derivatives of the light by the albedos there.
    """

    triangle: int
    cell: int
    onward: int
    light: Triple
    by_diffuse: Triple
    by_specular: Triple


@compiled
def followed(
    scene: LitScene,
    table: CellTable,
    origin: Vector,
    direction: Vector,
    density: float,
    key: Key,
    wants_diffuse: bool,
    wants_glossy: bool,
    turn: int,
) -> End:
    """Follow a ray to its end.

    Args:
        density: Density per solid angle with which the ray was drawn.
        wants_diffuse, wants_glossy: Compute the light of this lobe.
        turn: Number of the ray among those that gather together; with many lights each samples some of them.
    """
    triangle, a, b, distance, there = intersect(scene, origin, direction)
    if triangle < 0:
        return End(triangle, NOWHERE, NOWHERE, BLACK, BLACK, BLACK)
    cell = _cell_hit(scene, table, triangle, direction, there)
    # a ray that starts on another surface, where two touch, ends where it starts: it is not seen from anywhere
    if distance <= 0:
        return End(triangle, cell, NOWHERE, BLACK, BLACK, BLACK)
    diffuse, specular = triple(scene.material[triangle]), triple(scene.material[triangle, 3:6])
    point, normal, back = surface_at(scene, triangle, a, b, direction, there)
    cosine = dot(normal, back)
    shines = max(specular[0], specular[1], specular[2]) > 0 and cosine > 0
    alpha = blurred(alpha_of(scene, triangle), density) if shines else -1.0
    irradiance, glossy, slope = BLACK, BLACK, BLACK
    if wants_diffuse or (wants_glossy and shines):
        of_light, of_lobe = key_of(key, _LIGHT), alpha if wants_glossy else -1.0
        irradiance, glossy = direct_at(
            scene, point, normal, back, of_lobe, specular, 1, of_light, wants_diffuse, rays_to_all(scene), turn
        )
        irradiance = irradiance if wants_diffuse else BLACK
    light = added(product(diffuse, irradiance), product(specular, glossy))
    if not shines:
        return End(triangle, cell, NOWHERE, light, irradiance, slope)
    slope = slope_of(scene, glossy, cosine, alpha, specular)
    first, second = tangents(normal)
    view = in_frame(back, first, second, normal)
    continues, direction = continuation(
        scene, view, alpha, specular, uniform(key, _LOBE_U), uniform(key, _LOBE_V), uniform(key, _ABSORPTION), first,
        second, normal,
    )  # fmt: skip
    onward = NOWHERE
    if continues:
        other, _, _, _, there = intersect(scene, point, direction)
        onward = _cell_hit(scene, table, other, direction, there) if other >= 0 else NOWHERE
    return End(triangle, cell, onward, light, irradiance, slope)


@compiled
def continuation(
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
    """Draw a continuation from the glossy lobe; return whether there is one, and its direction.

    The lobe absorbs rays in proportion to the energy that it loses beyond its albedo.

    Args:
        view: Direction to the eye in the frame of tangents and normal.
    """
    toward, direction = draw_lobe(view, alpha, u, v, first, second, normal)
    reflected, by_lobe = lobe_and_pdf(view, toward, alpha)
    scale = 0.0
    for c in range(3):
        scale += scattering(scene, view[2], alpha, specular[c]) / 3
    return scale * reflected / max(by_lobe, 1e-30) > threshold, direction


@compiled
def follow_each(
    start: int,
    stop: int,
    scene: LitScene,
    table: CellTable,
    origins: Float[np.ndarray, "r 3"],
    directions: Float[np.ndarray, "r 3"],
    density: Float[np.ndarray, " r"],
    key: Key,
    cell: Int[np.ndarray, " r"],
    onward: Int[np.ndarray, " r"],
    light: Float[np.ndarray, "r 3"],
    triangle: Int[np.ndarray, " r"],
    by_diffuse: Float[np.ndarray, "r 3"],
    by_specular: Float[np.ndarray, "r 3"],
) -> None:
    """Follow rays one by one; see `followed`."""
    for row in range(start, stop):
        of_ray, origin, direction = key_of(key, row), triple(origins[row]), triple(directions[row])
        end = followed(scene, table, origin, direction, density[row], of_ray, True, True, row)
        triangle[row], cell[row], onward[row] = end.triangle, end.cell, end.onward
        for c in range(3):
            light[row, c], by_diffuse[row, c], by_specular[row, c] = end.light[c], end.by_diffuse[c], end.by_specular[c]


@compiled
def cast_each(
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
    """Fill in the arrays of `PixelCells`.

    Args:
        point_of: Rows of each pixel's points, -1 for none.
        width: Width of the image in pixels.
        light: `PixelCells.bounced`.
        trace: Derivatives of `light`.
    """
    rays, traced = diffuse.shape[1], trace.triangle.shape[1] > 0
    for pixel in range(start, stop):
        own_key = key_of(key, pixel)
        # the rays of a tile's pixels form one lattice
        tile, place = tile_of(pixel, width)
        of_tile = key_of(key_of(key, -1), tile)
        turn = uniform(own_key, -1)
        for s in range(rays):
            row = _start(point_of[pixel], s)
            if row < 0:
                continue
            u, v = _of_lattice(place + TILE * TILE * s, rays * TILE * TILE, of_tile)
            point, normal, alpha = triple(points.point[row]), triple(points.normal[row]), points.alpha[row]
            specular = triple(points.specular[row])
            first, second = tangents(normal)
            view = in_frame(points.eye[row], first, second, normal)
            # as dense as diffuse light arrives: points of a disc, lifted (Malley 1988)
            radius, angle = np.sqrt(u), 2 * np.pi * v
            toward = (radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u))
            direction = in_world(toward, first, second, normal)
            # the density of the diffuse lobe alone: where the glossy lobe is dense, too, diffuse rays are as few as
            # anywhere, and one that met a highlight in a mirror, not blurred, would light a window of pixels
            end = followed(
                scene, table, point, direction, toward[2] / np.pi, key_of(own_key, 2 * s), True, True, place + s
            )
            diffuse[pixel, s], diffuse_on[pixel, s] = end.cell, end.onward
            for c in range(3):
                light[pixel, c] += end.light[c] / rays
            if traced and end.triangle >= 0:
                trace.triangle[pixel, s] = end.triangle
                for c in range(3):
                    trace.diffuse[pixel, s, c] = end.by_diffuse[c] / rays
                    trace.specular[pixel, s, c] = end.by_specular[c] / rays
            if alpha < 0:
                continue
            # each ray of a pixel is absorbed above a threshold of its own
            threshold = (s + turn * rays) % rays / rays
            continues, direction = continuation(scene, view, alpha, specular, u, v, threshold, first, second, normal)
            if not continues:
                continue
            toward, albedos = in_frame(direction, first, second, normal), (mean(points.diffuse[row]), mean(specular))
            density = density_of_lobes(*albedos, toward[2], lobe_and_pdf(view, toward, alpha)[1])
            # the emitters' light that comes this way is in `reflected_light`
            end = followed(scene, table, point, direction, density, key_of(own_key, 2 * s + 1), False, False, 0)
            glossy[pixel, s], glossy_on[pixel, s] = end.cell, end.onward


@compiled
def _start(point_of: Int[np.ndarray, " of_pixel"], number: int) -> int:
    """Return the point from which a pixel's ray starts; points on surfaces take turns."""
    for k in range(len(point_of)):
        row = point_of[(number + k) % len(point_of)]
        if row >= 0:
            return int64(row)
    return -1


@compiled
def _of_lattice(number: int, count: int, key: Key) -> tuple[float, float]:
    """Return a point of an even, displaced lattice in the unit square."""
    u, v = (number + 0.5) / count + uniform(key, 0), number * GOLDEN + uniform(key, 1)
    return u % 1, v % 1


@compiled
def _cell_hit(scene: LitScene, table: CellTable, triangle: int, direction: Vector, point: Vector) -> int:
    a, b, c = scene.positions[triangle]
    back = dot(normal_of(triple(a), triple(b), triple(c)), direction) > 0
    return cell_at(table, triangle, point, back)

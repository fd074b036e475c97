"""From which cells the light comes that a pixel sends to the camera, as the two lobes of its surface gather it."""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer import ggx
from rfpp.gbuffer.cells import NOWHERE, CellMap
from rfpp.gbuffer.first_hit import CELL_RAYS, GBuffer, SeenCells
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.ray_ends import RayEnds, density_of_lobes, ray_ends, thrown
from rfpp.gbuffer.surface import Surface, chunks, cosine_directions, lattice, local

#: Pixels along each side of a tile.
_TILE = 4


def with_cells(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    cells: CellMap,
    points: int = 1,
    seed: int = 0,
) -> GBuffer:
    """The same G-buffer with the cells that its pixels see.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        cells: of the scene.
        points: where the G-buffer has so many points along each side of a pixel, its rays start from them in turn, and
            each of them says where all went.
        seed: of the rays' displacement from pixel to pixel; the same seed gives the same numbers.
    """
    rng = np.random.default_rng(seed)
    height, width = (side // points for side in gbuffer.depth.shape)
    surface = Surface.seen(gbuffer, sampler.triangles, c2w, fov)
    number = np.full(gbuffer.depth.shape, -1)
    number[gbuffer.hit] = np.arange(len(surface))
    by_pixel = number.reshape(height, points, width, points).swapaxes(1, 2).reshape(height * width, -1)
    start = by_pixel[:, np.arange(CELL_RAYS) % points**2]
    random = _directions(height, width, rng)
    seen = np.full((4, height * width, CELL_RAYS), NOWHERE, np.int32)
    light = np.zeros((height * width, CELL_RAYS, 3), np.float32)
    for rows in chunks(height * width, CELL_RAYS):
        hit = start[rows] >= 0
        rays = surface.part(start[rows][hit])
        ends = _diffuse(rays, sampler, cells, random[rows][hit])
        seen[0, rows][hit], seen[2, rows][hit] = ends.cell, ends.onward(sampler, cells, rng)
        light[rows][hit] = ends.highlights(sampler, rng)
        # each ray of a pixel is absorbed above a threshold of its own
        threshold = rng.permuted((np.arange(CELL_RAYS) + rng.random((len(hit), 1))) / CELL_RAYS, axis=1)[hit]
        seen[1, rows][hit], seen[3, rows][hit] = _glossy(rays, sampler, cells, random[rows][hit], threshold, rng)

    def at_points(of_pixels: np.ndarray) -> np.ndarray:
        return of_pixels.reshape(height, width, -1).repeat(points, axis=0).repeat(points, axis=1)

    return replace(gbuffer, cells=SeenCells(*map(at_points, seen), highlights=at_points(light.mean(1))))


def _directions(height: int, width: int, rng: np.random.Generator) -> Float[np.ndarray, "p rays 2"]:
    """Points of the unit square for the rays of every pixel; those of a tile's pixels together are one lattice.

    What a pixel's few rays miss, its neighbours' find, which share what they gather.
    """
    rows, columns = np.divmod(np.arange(height * width), width)
    tile, tiles = (rows // _TILE) * -(-width // _TILE) + columns // _TILE, -(-height // _TILE) * -(-width // _TILE)
    points = lattice(CELL_RAYS * _TILE**2, rng.random((tiles, 2)))
    first = (rows % _TILE) * _TILE + columns % _TILE
    return points[tile[:, None], first[:, None] + _TILE**2 * np.arange(CELL_RAYS)]


def _diffuse(surface: Surface, sampler: LightSampler, cells: CellMap, random: Float[np.ndarray, "r 2"]) -> RayEnds:
    way = cosine_directions(surface, random)
    frame = surface.frame()
    by_lobe = ggx.pdf(local(surface.view, frame), local(way, frame), surface.alpha)
    density = density_of_lobes(surface, (surface.normal * way).sum(-1), by_lobe)
    return ray_ends(sampler, cells, surface.point, way, density)


def _glossy(
    surface: Surface,
    sampler: LightSampler,
    cells: CellMap,
    random: Float[np.ndarray, "r 2"],
    threshold: Float[np.ndarray, " r"],
    rng: np.random.Generator,
) -> Int[np.ndarray, "2 r"]:
    """Where rays end, and where they are thrown on from there. A ray that the lobe absorbs sees nothing."""
    way, sent = thrown(surface, random, threshold)
    surface, way = surface.part(sent), way[sent]
    frame = surface.frame()
    incoming = local(way, frame)
    by_lobe = ggx.pdf(local(surface.view, frame), incoming, surface.alpha)
    ends = ray_ends(sampler, cells, surface.point, way, density_of_lobes(surface, incoming[:, 2], by_lobe))
    found = np.full((2, len(threshold)), NOWHERE)
    found[:, sent] = ends.cell, ends.onward(sampler, cells, rng)
    return found

"""From which cells the light comes that a pixel sends to the camera, as the two lobes of its surface gather it."""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer import ggx
from rfpp.gbuffer.cells import NOWHERE, CellMap
from rfpp.gbuffer.first_hit import CELL_RAYS, GBuffer, SeenCells
from rfpp.gbuffer.raycast import RayCaster
from rfpp.gbuffer.surface import Surface, chunks, cosine_directions, lattice, local
from rfpp.scene.triangles import SceneTriangles

#: Pixels along each side of a tile.
_TILE = 4


def with_cells(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    triangles: SceneTriangles,
    caster: RayCaster,
    cells: CellMap,
    points: int = 1,
    seed: int = 0,
) -> GBuffer:
    """The same G-buffer with the cells that its pixels see.

    Args:
        gbuffer: of the triangles.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        caster: over all of the triangles.
        cells: of the triangles.
        points: where the G-buffer has so many points along each side of a pixel, its rays start from them in turn, and
            each of them says where all went.
        seed: of the rays' displacement from pixel to pixel; the same seed gives the same numbers.
    """
    rng = np.random.default_rng(seed)
    height, width = (side // points for side in gbuffer.depth.shape)
    surface = Surface.seen(gbuffer, triangles, c2w, fov)
    number = np.full(gbuffer.depth.shape, -1)
    number[gbuffer.hit] = np.arange(len(surface))
    by_pixel = number.reshape(height, points, width, points).swapaxes(1, 2).reshape(height * width, -1)
    start = by_pixel[:, np.arange(CELL_RAYS) % points**2]
    random = _directions(height, width, rng)
    seen = np.full((2, height * width, CELL_RAYS), NOWHERE, np.int32)
    for rows in chunks(height * width, CELL_RAYS):
        hit = start[rows] >= 0
        rays = surface.part(start[rows][hit])
        seen[0, rows][hit] = _diffuse(rays, caster, cells, random[rows][hit])
        # each ray of a pixel is absorbed above a threshold of its own
        threshold = rng.permuted((np.arange(CELL_RAYS) + rng.random((len(hit), 1))) / CELL_RAYS, axis=1)[hit]
        seen[1, rows][hit] = _glossy(rays, caster, cells, random[rows][hit], threshold)
    seen = seen.reshape(2, height, width, CELL_RAYS).repeat(points, axis=1).repeat(points, axis=2)
    return replace(gbuffer, cells=SeenCells(*seen))


def _directions(height: int, width: int, rng: np.random.Generator) -> Float[np.ndarray, "p rays 2"]:
    """Points of the unit square for the rays of every pixel; those of a tile's pixels together are one lattice.

    What a pixel's few rays miss, its neighbours' find, which share what they gather.
    """
    rows, columns = np.divmod(np.arange(height * width), width)
    tile, tiles = (rows // _TILE) * -(-width // _TILE) + columns // _TILE, -(-height // _TILE) * -(-width // _TILE)
    points = lattice(CELL_RAYS * _TILE**2, rng.random((tiles, 2)))
    first = (rows % _TILE) * _TILE + columns % _TILE
    return points[tile[:, None], first[:, None] + _TILE**2 * np.arange(CELL_RAYS)]


def _diffuse(
    surface: Surface, caster: RayCaster, cells: CellMap, random: Float[np.ndarray, "r 2"]
) -> Int[np.ndarray, " r"]:
    way = cosine_directions(surface, random)
    return cells.of_hits(surface.point, way, caster.cast(surface.point, way))


def _glossy(
    surface: Surface,
    caster: RayCaster,
    cells: CellMap,
    random: Float[np.ndarray, "r 2"],
    threshold: Float[np.ndarray, " r"],
) -> Int[np.ndarray, " r"]:
    """The lobe absorbs a ray, which then sees nothing, in the share in which it does not send its light on."""
    frame = surface.frame()
    view = local(surface.view, frame)
    incoming = ggx.sample(view, surface.alpha, random)
    density = np.maximum(ggx.pdf(view, incoming, surface.alpha), 1e-30)
    scale = ggx.multiple_scattering(view[:, 2], surface.alpha, surface.specular).mean(-1)
    sent = scale * ggx.lobe(view, incoming, surface.alpha) / density > threshold
    sent &= (surface.specular > 0).any(-1)
    point, way = surface.point[sent], np.einsum("rk,rkx->rx", incoming[sent], frame[sent])
    found = np.full(len(surface), NOWHERE)
    found[sent] = cells.of_hits(point, way, caster.cast(point, way))
    return found

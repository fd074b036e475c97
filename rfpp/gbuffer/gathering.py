"""From which cells the light comes that a pixel sends to the camera, as the two lobes of its surface gather it."""

from __future__ import annotations

from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.cell_loops import cells_seen
from rfpp.gbuffer.cell_table import NOWHERE
from rfpp.gbuffer.cells import CellMap
from rfpp.gbuffer.first_hit import CELL_RAYS, GBuffer, SeenCells
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.surface import Surface
from rfpp.gbuffer.threads import over_rows
from rfpp.gbuffer.traces import Trace


def with_cells(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    cells: CellMap,
    seed: int = 0,
    traced: bool = False,
    rays: int = CELL_RAYS,
) -> GBuffer:
    """The same G-buffer with the cells that its pixels see.

    The rays of a pixel start from its points in turn, and each of them says where all went.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        cells: of the scene.
        seed: of the rays' displacement from pixel to pixel; the same seed gives the same numbers.
        traced: whether it is wanted where the light of the first bounce comes from.
        rays: S, that are cast for each pixel and lobe.
    """
    points = gbuffer.points
    height, width = (side // points for side in gbuffer.depth.shape)
    surface = Surface.seen(gbuffer, sampler.triangles, c2w, fov)
    of_image = surface.points(gbuffer.hit, points)
    point_of = np.full((height * width, of_image.of_pixel), -1)
    point_of[of_image.pixel, of_image.nth] = np.arange(len(surface))
    seen = np.full((4, height * width, rays), NOWHERE, np.int32)
    bounced = np.zeros((height * width, 3), np.float32)
    key = int(np.random.default_rng(seed).integers(1 << 62))
    trace = Trace.of(height * width, rays if traced else 0)
    image = (of_image, point_of, width, key, *seen, bounced, trace)
    over_rows(height * width, cells_seen, sampler.scene, cells.table, *image)

    def at_points(of_pixels: np.ndarray) -> np.ndarray:
        return of_pixels.reshape(height, width, -1).repeat(points, axis=0).repeat(points, axis=1)

    diffuse, glossy, diffuse_onward, glossy_onward = map(at_points, seen)
    ends = (diffuse, glossy, diffuse_onward, glossy_onward)
    return replace(gbuffer, cells=SeenCells(*ends, at_points(bounced), trace if traced else None))


def rays_beside(light_samples: int) -> int:
    """Rays of a pixel and lobe to cells that go with so many light samples: as many, up to CELL_RAYS."""
    return min(light_samples, CELL_RAYS)

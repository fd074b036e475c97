"""Inputs of radiosity for a scene and its cameras, cached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from rfpp.inference.bounded_cache import BoundedCache, digest_of
from rfpp.inference.gbuffers import GBufferSource, geometry_digest
from rfpp.inference.plan import Plan
from rfpp.radiosity.cell_finding import CellSources, cells_at
from rfpp.radiosity.cell_places import CellPlaces, find_places
from rfpp.radiosity.cell_tensors import row_of
from rfpp.radiosity.cells import CellMap, Cells
from rfpp.radiosity.pixel_rays import PixelCells, cast_to_cells
from rfpp.radiosity.radiosity import Radiosity
from rfpp.radiosity.view import View
from rfpp.raycast.first_hit import GBuffer, channel
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles


@dataclass(frozen=True, eq=False)
class ViewInputs:
    """G-buffer of a view, with the cells that its pixels see."""

    gbuffer: GBuffer
    cells: PixelCells


class RadiositySource:
    """Source of cells and views that caches what depends on geometry alone.

    Args:
        max_bytes: Limit of the caches of G-buffers and of cells, each.
    """

    def __init__(self, max_bytes: int = 1 << 30):
        self.gbuffers = GBufferSource(Radiosity.gbuffer_channels, max_bytes)
        self._cache: BoundedCache = BoundedCache(max_bytes)

    def cells(self, triangles: SceneTriangles, light: str | None = None) -> tuple[Cells, CellSources]:
        """Return the scene's cells and their dependence on materials.

        Args:
            light: Object whose light alone counts; None for all lights.
        """
        key = ("cells", geometry_digest(triangles), digest_of(triangles.material), light)
        places = self._places(triangles)
        return self._cache.get_or_compute(key, None, lambda: cells_at(places, self.gbuffers.lights(triangles, light)))

    def cell_map(self, triangles: SceneTriangles) -> CellMap:
        """Return the map from points of the scene to its cells."""
        return self._places(triangles).map

    def inputs(self, plan: Plan, view: int, light: str | None = None, traced: bool = False) -> ViewInputs:
        """Return a view's G-buffer and the cells that its pixels see; see `GBufferSource.gbuffer`."""
        scene = plan.scene
        gbuffer = self.gbuffers.gbuffer(scene, view, *plan.size, plan.light_samples, plan.points, light, traced)
        lights, cell_map = self.gbuffers.lights(scene.triangles, light), self.cell_map(scene.triangles)
        camera = scene.c2w[view], scene.fov[view]
        return ViewInputs(gbuffer, cast_to_cells(gbuffer, *camera, lights, cell_map, plan.light_samples, traced=traced))

    def _places(self, triangles: SceneTriangles) -> CellPlaces:
        def find() -> CellPlaces:
            return find_places(triangles, self.gbuffers.shadow_caster(triangles))

        return self._cache.get_or_compute(("places", geometry_digest(triangles)), None, find)


def as_tensors(inputs: ViewInputs, scene: PackedScene, view: int, cells: int, device: torch.device) -> View:
    """Move a view to a device."""

    def on_device(last: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(np.moveaxis(last, -1, 0))).to(device)

    gbuffer, material, fov = inputs.gbuffer, scene.triangles.material, scene.fov[view]
    names = ("diffuse", "glossy", "diffuse_onward", "glossy_onward")
    return View(
        channels={name: on_device(channel(gbuffer, material, fov, name)) for name in Radiosity.gbuffer_channels},
        **{name: row_of(on_device(getattr(inputs.cells, name)), cells) for name in names},
        bounced=on_device(inputs.cells.bounced),
        fov=float(fov),
        points=gbuffer.points,
    )

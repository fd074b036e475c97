"""What a network is given of each view besides the scene tokens; rays are not cast twice for the same answer."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.cell_finding import CellSources, cells_at
from rfpp.gbuffer.cell_places import CellPlaces, find_places
from rfpp.gbuffer.cell_table import NOWHERE
from rfpp.gbuffer.cells import Cells
from rfpp.gbuffer.first_hit import (
    BOUNCED_LIGHT,
    CELL_CHANNELS,
    DIRECT_CHANNELS,
    REFLECTION_CHANNELS,
    GBuffer,
    camera_caster,
    first_hit,
    stack_channels,
)
from rfpp.gbuffer.gathering import rays_beside, with_cells
from rfpp.gbuffer.known_light import with_known_light
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.object_light import object_light
from rfpp.gbuffer.raycast import RayCaster
from rfpp.inference.bounded_cache import BoundedCache
from rfpp.inference.digest import digest_of
from rfpp.model.view_channels import channel_sizes
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles

#: What Embree keeps of a triangle, about.
_BYTES_PER_TRIANGLE = 200
#: What a LightSampler keeps of one besides.
_SAMPLER_BYTES_PER_TRIANGLE = 8
#: Of a GBuffer: triangle, normal and depth.
_BYTES_PER_PIXEL = 20
#: What cells keep, about: of small scenes more of them than triangles.
_CELL_BYTES_PER_TRIANGLE = 1000
#: Of the light of one.
_BYTES_PER_OBJECT = 12


class GBufferSource:
    """The G-buffer channels of views, which keeps what cameras saw first and the structures that rays are cast into.

    First hits depend on the triangles' positions and normals, on which of them emit, and on the camera: new colours or
    another power of a light change none of them. Materials are looked up anew in every G-buffer, direct light and
    reflections are gathered anew.

    Args:
        channels: names from `rfpp.gbuffer.first_hit.CHANNELS`, in order.
        max_bytes: of what is kept.
    """

    def __init__(self, channels: Sequence[str], max_bytes: int = 1 << 30):
        self.channels = tuple(channels)
        self._kept: BoundedCache[GBuffer | RayCaster | LightSampler | np.ndarray] = BoundedCache(max_bytes)

    def of(
        self,
        scene: PackedScene,
        height: int,
        width: int,
        light_samples: int,
        points: int = 1,
        light: str | None = None,
    ) -> Callable[[int], Float[np.ndarray, "c h w"]]:
        """View number → its channels; no ray is cast before a view is asked for, and none for no channels.

        Args:
            height, width: in pixels.
            light_samples: of each pixel, divided among its points, of which each gets one or more
                (`with_known_light`); as many rays to cells go with them (`rays_beside`).
            points: along each side of a pixel; the channels have so many times the height and the width.
            light: only the light of this object; None: all.
        """
        height, width = points * height, points * width
        if not self.channels:
            return lambda view: np.zeros((0, height, width), np.float32)
        seen, material = self.seen(scene, height, width, light_samples, points, light), scene.triangles.material
        return lambda view: stack_channels(seen(view), material, scene.fov[view], self.channels)

    def seen(
        self,
        scene: PackedScene,
        height: int,
        width: int,
        light_samples: int,
        points: int = 1,
        light: str | None = None,
        traced: bool = False,
    ) -> Callable[[int], GBuffer]:
        """View number → all that `channels` are made of.

        Args:
            height, width: of the G-buffer.
            others: see `of`.
            traced: whether it is wanted where light comes from (`rfpp.gbuffer.traces`).
        """
        triangles = scene.triangles
        geometry = _geometry(triangles)

        def of_view(view: int) -> GBuffer:
            c2w, fov = scene.c2w[view], scene.fov[view]
            of_point = max(1, round(light_samples / points**2))
            gbuffer = self._first_hit(triangles, geometry, c2w, fov, height, width, points)
            seen, lights = (c2w, fov), partial(self._lights, triangles, geometry, light)
            if self._wants(DIRECT_CHANNELS) or self._wants(REFLECTION_CHANNELS):
                reflects = self._wants(REFLECTION_CHANNELS)
                how = {"reflects": reflects, "traced": traced}
                gbuffer = with_known_light(gbuffer, *seen, lights(), of_point, **how)
            if self._wants((*CELL_CHANNELS, BOUNCED_LIGHT)):
                cells = self._places(triangles, geometry).map
                rays = rays_beside(light_samples)
                gbuffer = with_cells(gbuffer, *seen, lights(), cells, traced=traced, rays=rays)
            return gbuffer

        return of_view

    def _wants(self, channels: Collection[str]) -> bool:
        return not set(self.channels).isdisjoint(channels)

    def object_light(self, triangles: SceneTriangles) -> Float[np.ndarray, "o 3"]:
        """See `rfpp.gbuffer.object_light`."""
        geometry = _geometry(triangles)
        key = ("object light", geometry, digest_of(triangles.material))
        size = _BYTES_PER_OBJECT * triangles.num_objects
        return self._kept.recall(key, size, lambda: object_light(self._lights(triangles, geometry)))

    def known_of_scene(
        self, triangles: SceneTriangles, names: Collection[str], light: str | None = None
    ) -> dict[str, Any]:
        """What a network reads of a scene beside its triangles: `object_light`, `cells`.

        Args:
            light: see `of`; of `cells` alone.
        """
        known = {
            "object_light": lambda: self.object_light(triangles),
            "cells": lambda: self._cells(triangles, _geometry(triangles), light)[0],
        }
        return {name: known[name]() for name in names}

    def cell_sources(self, triangles: SceneTriangles) -> CellSources:
        """What the numbers of `cells` are made of."""
        return self._cells(triangles, _geometry(triangles), None)[1]

    def _cells(self, triangles: SceneTriangles, geometry: bytes, light: str | None) -> tuple[Cells, CellSources]:
        def find() -> tuple[Cells, CellSources]:
            return cells_at(self._places(triangles, geometry), self._lights(triangles, geometry, light))

        key = ("cells", geometry, digest_of(triangles.material), light)
        return self._kept.recall(key, _CELL_BYTES_PER_TRIANGLE * len(triangles), find)

    def _places(self, triangles: SceneTriangles, geometry: bytes) -> CellPlaces:
        def find() -> CellPlaces:
            return find_places(triangles, self._shadow_caster(triangles, geometry))

        return self._kept.recall(("places", geometry), _CELL_BYTES_PER_TRIANGLE * len(triangles), find)

    def _first_hit(
        self,
        triangles: SceneTriangles,
        geometry: bytes,
        c2w: Float[np.ndarray, "4 4"],
        fov: np.floating,
        height: int,
        width: int,
        points: int,
    ) -> GBuffer:
        def cast() -> GBuffer:
            size = _BYTES_PER_TRIANGLE * len(triangles)
            caster = self._kept.recall(("caster", geometry), size, lambda: camera_caster(triangles))
            return first_hit(triangles, c2w, fov, height, width, caster, points)

        view = (geometry, c2w.tobytes(), float(fov), height, width, points)
        return self._kept.recall(view, _BYTES_PER_PIXEL * height * width, cast)

    def _lights(self, triangles: SceneTriangles, geometry: bytes, light: str | None = None) -> LightSampler:
        key = ("lights", geometry, digest_of(triangles.material))  # all materials: it knows what surfaces reflect
        size = _SAMPLER_BYTES_PER_TRIANGLE * len(triangles)
        lights = self._kept.recall(key, size, lambda: LightSampler(triangles, self._shadow_caster(triangles, geometry)))
        return lights if light is None else lights.only(light)

    def _shadow_caster(self, triangles: SceneTriangles, geometry: bytes) -> RayCaster:
        size = _BYTES_PER_TRIANGLE * len(triangles)
        return self._kept.recall(("shadows", geometry), size, lambda: RayCaster(triangles.positions))


def direct_alone(gbuffer: Float[np.ndarray, "c h w"], names: Sequence[str]) -> Float[np.ndarray, "c h w"]:
    """Channels without what surfaces send to each other: no reflections, nothing bounced, and rays that meet no cell.

    Args:
        names: of the channels, in order.
    """
    nothing = dict.fromkeys(CELL_CHANNELS, NOWHERE) | dict.fromkeys((*REFLECTION_CHANNELS, BOUNCED_LIGHT), 0)
    alone, row = gbuffer.copy(), 0
    for name, size in zip(names, channel_sizes(names, len(gbuffer)), strict=True):
        rows = slice(row, row := row + size)
        if name in nothing:
            alone[rows] = nothing[name]
    return alone


def _geometry(triangles: SceneTriangles) -> bytes:
    return digest_of(triangles.positions, triangles.normals, triangles.is_emissive, triangles.object_offsets)

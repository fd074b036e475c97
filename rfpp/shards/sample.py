"""The sample format: keys, contents and precision.

`data/README.md` lists the members for people; `encode` and `decode` are the definition.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from rfpp.errors import ShardError
from rfpp.radiosity.cells import Cells, parts
from rfpp.raycast.first_hit import (
    BOUNCED_LIGHT,
    CELL_CHANNELS,
    CELL_RAYS,
    CHANNELS,
    DIRECT_CHANNELS,
    REFLECTION_CHANNELS,
    DirectLight,
    GBuffer,
    Reflection,
    SeenCells,
)
from rfpp.imaging.exr import ImageFileError, decode_exr, encode_exr
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.light_layers import LightLayers, decode_lights, encode_lights, require_whole_lights
from rfpp.shards.whole import (
    CELL_ENDS,
    require_half_range,
    require_whole_cells,
    require_whole_scene,
    require_whole_views,
)

#: Raised whenever a member, a dtype or a meaning changes; data of another version is refused, never guessed at.
SCHEMA_VERSION = 8

#: From the sample's number of views to the numbers of those wanted.
ViewChoice = Callable[[int], Iterable[int]]

# A view's layers lie in several files, because a file is decoded whole: what training does not read is left alone.
_IMAGE, _SURFACE, _LIGHT, _REFLECTION, _CELLS = (
    f"view{{}}{kind}.exr" for kind in ("", ".surface", ".light", ".reflection", ".cells")
)


@dataclass(frozen=True, eq=False)
class SceneSample:
    """One scene with cameras, images and G-buffers.

    Attributes:
        key: unique in the data set, e.g. "train-000012".
        triangles: the whole scene in world space.
        c2w: [V, 4, 4] float32 camera-to-world, Blender axes.
        fov: [V] float32 degrees along the longer image side.
        images: [V, H, W, 3] float32 linear radiance; half-precision values once stored.
        gbuffers: V G-buffers with their direct light, their reflection and the cells they see.
        object_light: [O, 3] float32 radiance that leaves each object by the first bounce (`rfpp.raycast.object_light`).
        cells: of the scene (`rfpp.radiosity.cells`).
        meta: JSON-able: how the scene was made.
        lights: all of its light apart for each light, where that is stored and was asked for.
    """

    key: str
    triangles: SceneTriangles
    c2w: Float[np.ndarray, "v 4 4"]
    fov: Float[np.ndarray, " v"]
    images: Float[np.ndarray, "v h w 3"]
    gbuffers: tuple[GBuffer, ...]
    object_light: Float[np.ndarray, "o 3"]
    cells: Cells
    meta: dict
    lights: LightLayers | None = None


def encode(sample: SceneSample) -> dict[str, bytes]:
    """Member name → bytes; equal samples give equal bytes.

    Raises:
        ShardError: a radiance that is NaN, infinite or beyond half precision; it is never clipped.
    """
    geometry = {
        "positions": sample.triangles.positions.astype(np.float32),
        "normals": sample.triangles.normals.astype(np.float16),
        "material": _per_object_if_constant(sample.triangles),
        "object_offsets": sample.triangles.object_offsets.astype(np.int32),
        "object_light": sample.object_light.astype(np.float32),
    }
    cameras = {"c2w": sample.c2w.astype(np.float32), "fov": sample.fov.astype(np.float32)}
    meta = {**sample.meta, "schema_version": SCHEMA_VERSION, "objects": list(sample.triangles.object_names)}
    members = {
        "meta.json": json.dumps(meta, sort_keys=True, indent=1, allow_nan=False).encode(),
        "geometry.safetensors": save_arrays({name: np.ascontiguousarray(a) for name, a in geometry.items()}),
        "cameras.safetensors": save_arrays({name: np.ascontiguousarray(a) for name, a in cameras.items()}),
        "cells.safetensors": save_arrays({name: _stored(name, a) for name, a in parts(sample.cells).items()}),
    }
    for view, (image, gbuffer) in enumerate(zip(sample.images, sample.gbuffers, strict=True)):
        light = {"direct_diffuse": gbuffer.light.diffuse, "direct_glossy": gbuffer.light.glossy}
        reflection = {"reflected_light": gbuffer.reflection.light, "reflected_albedo": gbuffer.reflection.albedo}
        for name, radiance in {"RGB": image, **light, **reflection, BOUNCED_LIGHT: gbuffer.cells.bounced}.items():
            require_half_range(radiance, f"{sample.key}: view {view}: {name}")
        surface = {
            "normal": gbuffer.normal.astype(np.float16),
            "depth": gbuffer.depth.astype(np.float32),
            "triangle": (gbuffer.triangle + 1).astype(np.uint32),
        }
        rays = {f"{name}{ray}": of[..., ray] for name, of in gbuffer.cells.rays.items() for ray in range(CELL_RAYS)}
        seen = {name: (cell + 1).astype(np.uint32) for name, cell in rays.items()}
        members[_CELLS.format(view)] = encode_exr(seen | {BOUNCED_LIGHT: gbuffer.cells.bounced.astype(np.float16)})
        members[_IMAGE.format(view)] = encode_exr({"RGB": image.astype(np.float16)})
        members[_SURFACE.format(view)] = encode_exr(surface)
        for member, layers in ((_LIGHT, light), (_REFLECTION, reflection)):
            members[member.format(view)] = encode_exr({name: a.astype(np.float16) for name, a in layers.items()})
    return members if sample.lights is None else members | encode_lights(sample.key, sample.lights)


def decode(
    key: str,
    members: Mapping[str, bytes],
    choose: ViewChoice | None = None,
    channels: Collection[str] = tuple(CHANNELS),
    by_light: bool = True,
) -> SceneSample:
    """The inverse of `encode`, for the requested views and channels.

    Args:
        key: of the sample.
        members: member name → bytes.
        choose: the sample's number of views → the numbers of those to decode; None decodes all.
        channels: what is wanted of the G-buffers, which do without direct light or reflection accordingly.
        by_light: whether the light of each light is wanted, where it is stored.

    Raises:
        ShardError: naming the key: a missing or damaged member, another schema.
    """
    try:
        meta = json.loads(members["meta.json"])
        if not isinstance(meta, dict):
            raise ValueError("meta.json is no object")
        if meta.pop("schema_version", None) != SCHEMA_VERSION:
            raise ShardError(f"{key}: not of schema version {SCHEMA_VERSION}: generate the data again")
        geometry = load_arrays(members["geometry.safetensors"])
        cameras = load_arrays(members["cameras.safetensors"])
        stored = load_arrays(members["cells.safetensors"])
        cells = Cells(**(stored | {name: stored[name].astype(np.int32) for name in CELL_ENDS}))
        views = list((choose or range)(len(cameras["fov"])))

        def layers(name: str, view: int) -> dict[str, np.ndarray]:
            member = name.format(view)
            return decode_exr(members[member], f"{key}.{member}")

        triangles = SceneTriangles(
            positions=geometry["positions"],
            normals=geometry["normals"].astype(np.float32),
            material=_per_triangle(geometry["material"], geometry["object_offsets"]),
            object_offsets=geometry["object_offsets"],
            object_names=tuple(meta.pop("objects")),
        )
        require_whole_scene(triangles, geometry["object_light"], cameras)
        require_whole_cells(cells, triangles)
        images = np.stack([layers(_IMAGE, view)["RGB"] for view in views]).astype(np.float32)
        gbuffers = tuple(_gbuffer(partial(layers, view=view), channels) for view in views)
        require_whole_views(images, gbuffers, len(triangles), len(cells))
        lights = decode_lights(key, members, views) if by_light else None
        if lights is not None:
            require_whole_lights(lights, images, geometry["object_light"], cells)
        return SceneSample(
            key=key,
            triangles=triangles,
            c2w=cameras["c2w"][views],
            fov=cameras["fov"][views],
            images=images,
            gbuffers=gbuffers,
            object_light=geometry["object_light"],
            cells=cells,
            meta=meta,
            lights=lights,
        )
    except KeyError as error:
        raise ShardError(f"{key}: {error} is missing from the sample: generate its shard again") from error
    except (SafetensorError, ImageFileError, ValueError, TypeError, IndexError, RecursionError) as error:
        raise ShardError(f"{key}: a member is damaged ({error}): generate its shard again") from error


def _gbuffer(layers: Callable[[str], Mapping[str, np.ndarray]], channels: Collection[str]) -> GBuffer:
    """From the layers of a view's members, by their names."""

    def part(kind: type, member: str, names: Sequence[str]) -> DirectLight | Reflection | None:
        if set(names).isdisjoint(channels):
            return None
        stored = layers(member)
        return kind(*(stored[name].astype(np.float32) for name in names))

    surface = layers(_SURFACE)
    return GBuffer(
        triangle=surface["triangle"].astype(np.int32) - 1,
        normal=surface["normal"].astype(np.float32),
        depth=surface["depth"],
        light=part(DirectLight, _LIGHT, DIRECT_CHANNELS),
        reflection=part(Reflection, _REFLECTION, REFLECTION_CHANNELS),
        cells=None if {*CELL_CHANNELS, BOUNCED_LIGHT}.isdisjoint(channels) else _seen_cells(layers(_CELLS)),
    )


def _seen_cells(layers: Mapping[str, np.ndarray]) -> SeenCells:
    """From the layers of the rays, by their names."""
    rays = (np.stack([layers[f"{name}{ray}"] for ray in range(CELL_RAYS)], axis=-1) for name in CELL_CHANNELS)
    return SeenCells(*(cells.astype(np.int32) - 1 for cells in rays), layers[BOUNCED_LIGHT].astype(np.float32))


def _stored(name: str, of_cells: np.ndarray) -> np.ndarray:
    """An array of `Cells` as stored; ray ends, which are most of the data, as 16-bit integers if they fit."""
    small = name in CELL_ENDS and len(of_cells) < np.iinfo(np.int16).max
    return np.ascontiguousarray(of_cells, dtype=np.int16 if small else of_cells.dtype)


def _per_object_if_constant(triangles: SceneTriangles) -> np.ndarray:
    """[O, 10] when no object mixes materials, which is the rule and saves most of the bytes; else [M, 10]."""
    first = triangles.material[triangles.object_offsets[:-1]].astype(np.float32)
    if np.array_equal(first[triangles.object_index], triangles.material):
        return first
    return triangles.material.astype(np.float32)


def _per_triangle(material: np.ndarray, object_offsets: np.ndarray) -> np.ndarray:
    if len(material) == object_offsets[-1]:  # also right when every object is a single triangle
        return material
    return np.repeat(material, np.diff(object_offsets), axis=0)

"""The sample format: keys, contents and precision.

`data/README.md` lists the members; `encode` and `decode` define them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from rfpp.errors import ShardError
from rfpp.imaging.exr import ImageFileError, decode_exr, encode_exr
from rfpp.raycast.first_hit import CHANNELS, DIRECT_CHANNELS, DirectLight, GBuffer, Reflection
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.consistency import (
    require_consistent_light,
    require_consistent_scene,
    require_consistent_views,
    require_half_range,
)

#: Raised whenever a member, a dtype or a meaning changes; data of another version is refused.
SCHEMA_VERSION = 10

#: Number of a sample's views → indices of the views to read.
ViewChoice = Callable[[int], Iterable[int]]

# Each view is several files because a file is decoded as a whole; training skips the files it does not need.
_IMAGE, _SURFACE, _LIGHT, _REFLECTION = (f"view{{}}{kind}.exr" for kind in ("", ".surface", ".light", ".reflection"))
_REFLECTED = "reflected_light"


@dataclass(frozen=True, eq=False)
class SceneSample:
    """One scene with cameras, images and G-buffers.

    Attributes:
        key: unique name in the data set, e.g. "train-000012".
        triangles: the whole scene in world space.
        c2w: [V, 4, 4] float32 camera-to-world, Blender axes.
        fov: [V] float32 degrees along the longer image side.
        images: [V, H, W, 3] float32 linear radiance; half-precision values once stored.
        gbuffers: V G-buffers; all include direct light and reflection when written.
        meta: JSON-able account of the scene's origin.
        token_light: [O, 8, K + 1, 3] float32, see `rfpp.reference.labels.Labels`, or None.
    """

    key: str
    triangles: SceneTriangles
    c2w: Float[np.ndarray, "v 4 4"]
    fov: Float[np.ndarray, " v"]
    images: Float[np.ndarray, "v h w 3"]
    gbuffers: tuple[GBuffer, ...]
    meta: dict
    token_light: Float[np.ndarray, "o 8 k 3"] | None = None


def encode(sample: SceneSample) -> dict[str, bytes]:
    """Return the members of a sample by name; equal samples give equal bytes.

    Raises:
        ShardError: If a radiance is NaN, infinite or beyond half precision; values are never clipped.
    """
    geometry = {
        "positions": sample.triangles.positions.astype(np.float32),
        "normals": sample.triangles.normals.astype(np.float16),
        "material": _per_object_if_constant(sample.triangles),
        "object_offsets": sample.triangles.object_offsets.astype(np.int32),
    }
    if sample.token_light is not None:
        geometry["token_light"] = sample.token_light.astype(np.float16)
    cameras = {"c2w": sample.c2w.astype(np.float32), "fov": sample.fov.astype(np.float32)}
    meta = {**sample.meta, "schema_version": SCHEMA_VERSION, "objects": list(sample.triangles.object_names)}
    meta["one_sided"] = sorted(sample.triangles.one_sided)
    members = {
        "meta.json": json.dumps(meta, sort_keys=True, indent=1, allow_nan=False).encode(),
        "geometry.safetensors": save_arrays({name: np.ascontiguousarray(a) for name, a in geometry.items()}),
        "cameras.safetensors": save_arrays({name: np.ascontiguousarray(a) for name, a in cameras.items()}),
    }
    for view, (image, gbuffer) in enumerate(zip(sample.images, sample.gbuffers, strict=True)):
        direct = dict(zip(DIRECT_CHANNELS, (gbuffer.light.diffuse, gbuffer.light.glossy), strict=True))
        radiance = {_IMAGE: {"RGB": image}, _LIGHT: direct, _REFLECTION: {_REFLECTED: gbuffer.reflection.light}}
        members[_SURFACE.format(view)] = encode_exr(
            {
                "normal": gbuffer.normal.astype(np.float16),
                "depth": gbuffer.depth.astype(np.float32),
                "triangle": (gbuffer.triangle + 1).astype(np.uint32),
            }
        )
        for member, layers in radiance.items():
            for name, layer in layers.items():
                require_half_range(layer, f"{sample.key}: view {view}: {name}")
            members[member.format(view)] = encode_exr({name: a.astype(np.float16) for name, a in layers.items()})
    return members


def decode(
    key: str,
    members: Mapping[str, bytes],
    choose: ViewChoice | None = None,
    channels: Collection[str] = tuple(CHANNELS),
) -> SceneSample:
    """Invert `encode` for the requested views and channels.

    Args:
        choose: Views to decode; None decodes all.
        channels: G-buffer channels; files that hold none of them are not decoded.

    Raises:
        ShardError: If a member is missing or damaged, or of another schema version; the error names the key.
    """
    try:
        meta = json.loads(members["meta.json"])
        if not isinstance(meta, dict):
            raise ValueError("meta.json is not an object")
        if meta.pop("schema_version", None) != SCHEMA_VERSION:
            raise ShardError(f"{key}: not of schema version {SCHEMA_VERSION}: generate the data again")
        geometry = load_arrays(members["geometry.safetensors"])
        cameras = load_arrays(members["cameras.safetensors"])
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
            one_sided=frozenset(meta.pop("one_sided")),
        )
        require_consistent_scene(triangles, cameras)
        images = np.stack([layers(_IMAGE, view)["RGB"] for view in views]).astype(np.float32)
        gbuffers = tuple(_gbuffer(partial(layers, view=view), channels) for view in views)
        require_consistent_views(images, gbuffers, len(triangles))
        light = geometry.get("token_light")
        if light is not None:
            require_consistent_light(light, triangles.num_objects)
            light = light.astype(np.float32)
        return SceneSample(key, triangles, cameras["c2w"][views], cameras["fov"][views], images, gbuffers, meta, light)
    except KeyError as error:
        raise ShardError(f"{key}: {error} is missing from the sample: generate its shard again") from error
    except (SafetensorError, ImageFileError, ValueError, TypeError, IndexError, RecursionError) as error:
        raise ShardError(f"{key}: a member is damaged ({error}): generate its shard again") from error


def _gbuffer(layers: Callable[[str], Mapping[str, np.ndarray]], channels: Collection[str]) -> GBuffer:
    """Decode a view's G-buffer; `layers` decodes one of its files."""
    surface, light, reflection = layers(_SURFACE), None, None
    if not set(DIRECT_CHANNELS).isdisjoint(channels):
        stored = layers(_LIGHT)
        light = DirectLight(*(stored[name].astype(np.float32) for name in DIRECT_CHANNELS))
    if _REFLECTED in channels:
        reflected = layers(_REFLECTION)[_REFLECTED].astype(np.float32)
        reflection = Reflection(reflected)
    return GBuffer(
        triangle=surface["triangle"].astype(np.int32) - 1,
        normal=surface["normal"].astype(np.float32),
        depth=surface["depth"],
        light=light,
        reflection=reflection,
    )


def _per_object_if_constant(triangles: SceneTriangles) -> np.ndarray:
    """Return [O, 10] if no object mixes materials, which saves most of the bytes, else [M, 10]."""
    first = triangles.material[triangles.object_offsets[:-1]].astype(np.float32)
    if np.array_equal(first[triangles.object_index], triangles.material):
        return first
    return triangles.material.astype(np.float32)


def _per_triangle(material: np.ndarray, object_offsets: np.ndarray) -> np.ndarray:
    if len(material) == object_offsets[-1]:  # also right if every object is a single triangle
        return material
    return np.repeat(material, np.diff(object_offsets), axis=0)

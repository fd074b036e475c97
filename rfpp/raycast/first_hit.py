"""First hits of camera rays: G-buffers for training data and for the renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import UserError
from rfpp.raycast.compiled import compiled
from rfpp.raycast.embree import closest
from rfpp.raycast.raycast import RayCaster
from rfpp.raycast.texel_lookup import SeenTexels, find_texels
from rfpp.raycast.threads import over_rows
from rfpp.raycast.traces import Trace
from rfpp.raycast.vectors import added, camera_axes, dot, in_frame, in_world, normal_of, scaled, triple, unit
from rfpp.scene.camera import pixel_plane
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR, SceneTriangles

#: Channels of direct light, in the units of `DirectLight`.
DIRECT_CHANNELS = ("direct_diffuse", "direct_glossy")
#: Channels that hold light; `reflected_light` is in the units of `Reflection`.
LIGHT_CHANNELS = (*DIRECT_CHANNELS, "reflected_light")
#: Channels whose three numbers are red, green and blue.
COLOR_CHANNELS = ("albedo", "specular", *LIGHT_CHANNELS)
#: G-buffer channels and the number of values of each.
CHANNELS: dict[str, int] = {"normal": 3, "roughness": 1, "depth": 1, "position": 3, **dict.fromkeys(COLOR_CHANNELS, 3)}

_MATERIAL_COLUMNS = {"albedo": DIFFUSE, "specular": SPECULAR, "roughness": ROUGHNESS}


@dataclass(frozen=True, eq=False)
class DirectLight:
    """Light straight from the emitters, shadows included, as the two lobes of a surface gather it.

    Attributes:
        diffuse: [H, W, 3] float32 irradiance / π: times the diffuse albedo it is outgoing radiance.
        glossy: [H, W, 3] float32: times the specular albedo it is outgoing radiance.
            Both are zeros where nothing is hit.
    """

    diffuse: Float[np.ndarray, "h w 3"]
    glossy: Float[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class Reflection:
    """Light that the glossy lobe gathers from other surfaces, which are lit by the emitters alone.

    Attributes:
        light: [H, W, 3] float32; times the specular albedo it is outgoing radiance. Zero where nothing is hit, the
            surface has no glossy lobe, or nothing is reflected.
        trace: Derivatives of the light by the albedos it comes from, for the hits row by row, if requested.
    """

    light: Float[np.ndarray, "h w 3"]
    trace: Trace | None = None


@dataclass(frozen=True, eq=False)
class GBuffer:
    """First hit of the ray through each pixel's center. Lights are invisible to the camera.

    Attributes:
        triangle: int32 index into the scene's triangles, -1 where nothing is hit.
        normal: float32 unit shading normal in camera space, on the camera's side of the surface; zeros where nothing
            is hit.
        depth: float32 distance along the camera's -Z axis (not along the ray); 0 where nothing is hit.
        light: Direct light at the hits, if requested (`rfpp.raycast.known_light`).
        reflection: Reflections in glossy surfaces, if requested.
        points: Points along each side of a pixel (`rfpp.scene.camera.pixel_plane`).
        texels: Texels at the hits, if the scene has any.
    """

    triangle: Int[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    light: DirectLight | None = None
    reflection: Reflection | None = None
    points: int = 1
    texels: SeenTexels | None = None

    @property
    def hit(self) -> np.ndarray:
        """True where a surface is hit."""
        return self.triangle >= 0


def camera_caster(triangles: SceneTriangles) -> RayCaster:
    """Return a ray caster over the surfaces visible to cameras, for `first_hit` with several cameras of one scene."""
    return RayCaster(triangles.positions[~triangles.is_emissive])


def first_hit(
    triangles: SceneTriangles,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    height: int,
    width: int,
    caster: RayCaster | None = None,
    points: int = 1,
) -> GBuffer:
    """Cast the G-buffer of one camera.

    Args:
        triangles: Triangles in world space.
        c2w: Camera to world, Blender axes.
        fov: Full angle in degrees along the longer image side.
        height, width, points: See `rfpp.scene.camera.pixel_plane`.
        caster: Result of `camera_caster(triangles)`; None builds it.
    """
    caster = caster or camera_caster(triangles)
    visible = np.flatnonzero(~triangles.is_emissive).astype(np.int32)
    if len(caster) != len(visible):
        raise ValueError("the caster belongs to other triangles: create it with camera_caster(triangles)")
    count = height * width
    found = np.empty(count, np.int32), np.empty((count, 3), np.float32), np.empty(count, np.float32)
    plane = pixel_plane(height, width, points).reshape(-1, 2)
    seen_from = plane, np.tan(np.radians(float(fov)) / 2), c2w.astype(np.float64)
    over_rows(count, _cast, caster.address, triangles.positions, triangles.normals, visible, *seen_from, *found)
    triangle, normal, depth = (of.reshape(height, width, *of.shape[1:]) for of in found)
    seen = None
    if (texels := triangles.texels) is not None:
        seen = find_texels(texels, triangles.positions, triangle, normal, depth, c2w, fov, points)
    return GBuffer(triangle, normal, depth, points=points, texels=seen)


@compiled
def _cast(
    start: int,
    stop: int,
    address: int,
    positions: Float[np.ndarray, "m 3 3"],
    normals: Float[np.ndarray, "m 3 3"],
    visible: Int[np.ndarray, " v"],
    plane: Float[np.ndarray, "pixels 2"],
    slope: float,
    pose: Float[np.ndarray, "4 4"],
    triangle: Int[np.ndarray, " pixels"],
    normal: Float[np.ndarray, "pixels 3"],
    depth: Float[np.ndarray, " pixels"],
) -> None:
    """Fill in the arrays of `GBuffer`."""
    right, up, back, eye = camera_axes(pose)
    for row in range(start, stop):
        toward = unit(slope * plane[row, 0], slope * plane[row, 1], -1.0)
        direction = in_world(toward, right, up, back)
        hit, u, v, distance = closest(address, eye, direction)
        triangle[row], depth[row] = -1, 0.0
        normal[row, 0], normal[row, 1], normal[row, 2] = 0.0, 0.0, 0.0
        if hit < 0:
            continue
        triangle[row], depth[row] = visible[hit], -toward[2] * distance
        corners, of_corners = positions[triangle[row]], normals[triangle[row]]
        across = normal_of(triple(corners[0]), triple(corners[1]), triple(corners[2]))
        side, (a, b, c) = -1.0 if dot(across, direction) > 0 else 1.0, of_corners
        shading = added(added(scaled(a, (1 - u - v) * side), scaled(b, u * side)), scaled(c, v * side))
        facing = unit(*in_frame(shading, right, up, back))
        normal[row, 0], normal[row, 1], normal[row, 2] = facing[0], facing[1], facing[2]


def stack_channels(
    gbuffer: GBuffer, material: Float[np.ndarray, "m 10"], fov: SupportsFloat, names: Sequence[str]
) -> Float[np.ndarray, "c h w"]:
    """Stack the named channels (see `CHANNELS`) in this order; zeros where nothing is hit.

    Args:
        material: Materials of the scene's triangles (`SceneTriangles.material`).
        fov: Degrees, as in `first_hit`.
        names: Channels; `position` is the camera-space point determined by pixel and depth.

    Raises:
        UserError: If there is no channel of a name.
        ValueError: If the G-buffer lacks the light of a channel.
    """
    channels = [channel(gbuffer, material, fov, name) for name in names]
    stacked = np.empty((sum(of.shape[-1] for of in channels), *gbuffer.depth.shape), np.float32)
    row = 0
    for of in channels:
        stacked[row : row + of.shape[-1]] = of.transpose(2, 0, 1)
        row += of.shape[-1]
    return stacked


def channel(
    gbuffer: GBuffer, material: Float[np.ndarray, "m 10"], fov: SupportsFloat, name: str
) -> Float[np.ndarray, "h w c"]:
    """Return one channel of `stack_channels`, channels last."""
    if name in _MATERIAL_COLUMNS:
        seen: np.ndarray = np.take(material[:, _MATERIAL_COLUMNS[name]], gbuffer.triangle, axis=0)
        seen *= gbuffer.hit[..., None]
        return seen if gbuffer.texels is None else gbuffer.texels.replaced(seen, _MATERIAL_COLUMNS[name])
    if name == "normal":
        return gbuffer.normal
    if name == "depth":
        return gbuffer.depth[..., None]
    if name == "position":
        return camera_positions(gbuffer.depth, fov, gbuffer.points)
    if name in DIRECT_CHANNELS:
        if gbuffer.light is None:
            raise ValueError(f"'{name}' needs a G-buffer with direct light: see with_known_light")
        return gbuffer.light.diffuse if name == "direct_diffuse" else gbuffer.light.glossy
    if name == "reflected_light":
        if gbuffer.reflection is None:
            raise ValueError(f"'{name}' needs a G-buffer with reflections: see with_known_light")
        return gbuffer.reflection.light
    raise UserError(f"G-buffer channel '{name}' does not exist: choose from {', '.join(CHANNELS)}")


def camera_positions(
    depth: Float[np.ndarray, "h w"], fov: SupportsFloat, points: int = 1
) -> Float[np.ndarray, "h w 3"]:
    """Return camera-space points from planar depth; the origin where depth is 0."""
    height, width = depth.shape
    slope = pixel_plane(height, width, points) * np.tan(np.radians(float(fov)) / 2)
    position = np.empty((*depth.shape, 3), np.float32)
    position[..., :2], position[..., 2] = slope * depth[..., None], -depth
    return position


def object_ids(gbuffer: GBuffer, triangles: SceneTriangles) -> Int[np.ndarray, "h w"]:
    """Return the int32 index of the object hit, -1 where nothing is hit."""
    return np.where(gbuffer.hit, triangles.object_index[gbuffer.triangle], -1).astype(np.int32)

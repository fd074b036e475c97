"""Preview pictures of scenes and stored samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import UInt8

from rfpp.imaging import panels
from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import DirectLight, GBuffer, camera_caster, channel, first_hit, object_ids
from rfpp.raycast.raycast import RayCaster
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.sample import SceneSample
from rfpp.shards.scene_rays import SceneRays

#: Ambient light in place of indirect light on contact sheets.
_AMBIENT = 0.08
_LIGHT_SAMPLES = 4
_WIREFRAME = 256  # minimum width in pixels, so that triangles of one pixel show their edges
_SUPERSAMPLING = 2


def sample_panel(sample: SceneSample) -> UInt8[np.ndarray, "h w 3"]:
    """Draw one row per view of a sample: image, direct and reflected light, G-buffers, and a wireframe."""
    triangles, material = sample.triangles, sample.triangles.material
    views = list(zip(sample.gbuffers, sample.c2w, sample.fov, strict=True))
    caster = camera_caster(triangles)
    columns = {
        "image": [panels.tone_mapped(image) for image in sample.images],
        "direct light": [panels.tone_mapped(direct_radiance(g, material)) for g, _, _ in views],
        "reflected light": [panels.tone_mapped(channel(g, material, f, "reflected_light")) for g, _, f in views],
        "albedo": [panels.tone_mapped(channel(g, material, f, "albedo")) for g, _, f in views],
        "specular": [panels.tone_mapped(channel(g, material, f, "specular")) for g, _, f in views],
        "normal": [_normal_colors(g) for g, _, _ in views],
        "depth (near is bright)": [_depth_colors(g) for g, _, _ in views],
        "objects": [panels.distinct_colors(object_ids(g, triangles)) for g, _, _ in views],
        "triangles": [
            _wireframe(triangles, pose, fov, *image.shape[:2], caster)
            for (_, pose, fov), image in zip(views, sample.images, strict=True)
        ],
    }
    captions = [
        f"view {index}: {fov:.0f} degrees, surfaces in {gbuffer.hit.mean():.0%} of the pixels, mean radiance "
        f"{image.mean():.3f}"
        for index, ((gbuffer, _, fov), image) in enumerate(zip(views, sample.images, strict=True))
    ]
    redraws = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in sample.meta.get("redraws", {}).items())
    title = ": ".join(filter(None, [sample.key, _contents(triangles)])) + (f"; {redraws}" if redraws else "")
    return panels.panel(columns, captions, title)


def contact_sheet(scenes: Iterable[Scene | PackedScene], resolution: int) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the first view of each scene without path tracing: direct light, shadows, and an ambient term."""
    packed = [pack(scene) for scene in scenes]
    captions = [f"{index}: {_contents(scene.triangles)}" for index, scene in enumerate(packed)]
    return panels.contact_sheet([_preview(scene, resolution) for scene in packed], captions)


def with_ambient(gbuffer: GBuffer, ambient: float) -> GBuffer:
    """Return the G-buffer with an ambient term added to its light."""
    return replace(gbuffer, light=DirectLight(gbuffer.light.diffuse + ambient, gbuffer.light.glossy + ambient))


def _preview(scene: PackedScene, resolution: int) -> UInt8[np.ndarray, "h w 3"]:
    pose, fov, rays = scene.c2w[0], scene.fov[0], SceneRays(scene.triangles)
    gbuffer = rays.with_direct_light(rays.first_hit(pose, fov, resolution), pose, fov, _LIGHT_SAMPLES, seed=0)
    return panels.tone_mapped(direct_radiance(with_ambient(gbuffer, _AMBIENT), scene.triangles.material))


def _wireframe(
    triangles: SceneTriangles, pose: np.ndarray, fov: SupportsFloat, height: int, width: int, caster: RayCaster
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw dark lines between pixels that see different triangles, over shading by normal."""
    enlarged = -(-_WIREFRAME // max(height, width))
    fine = enlarged * _SUPERSAMPLING
    gbuffer = first_hit(triangles, pose, fov, height * fine, width * fine, caster)
    padded = np.pad(gbuffer.triangle, ((0, 1), (0, 1)), mode="edge")
    edge = (padded[:-1, :-1] != padded[1:, :-1]) | (padded[:-1, :-1] != padded[:-1, 1:])
    shade = np.where(gbuffer.hit, 0.35 + 0.65 * gbuffer.normal[..., 2].clip(0), 1) * np.where(edge, 0.25, 1)
    blocks = shade.reshape(height * enlarged, _SUPERSAMPLING, width * enlarged, _SUPERSAMPLING).mean((1, 3))
    return np.repeat((255 * blocks).astype(np.uint8)[..., None], 3, axis=-1)


def _normal_colors(gbuffer: GBuffer) -> UInt8[np.ndarray, "h w 3"]:
    """Color normals: right is red, up is green, towards the camera is blue."""
    return (np.where(gbuffer.hit[..., None], gbuffer.normal.clip(-1, 1) + 1, 0) * 127.5).astype(np.uint8)


def _depth_colors(gbuffer: GBuffer) -> UInt8[np.ndarray, "h w 3"]:
    """Color depth from the nearest to the farthest hit; black where nothing is hit."""
    depths = gbuffer.depth[gbuffer.hit]
    near, far = (depths.min(), depths.max()) if len(depths) else (0.0, 0.0)
    share = (far - gbuffer.depth) / max(far - near, 1e-6)
    return panels.false_colors(np.where(gbuffer.hit, 0.1 + 0.9 * share, 0))


def _contents(triangles: SceneTriangles) -> str:
    lights = len(np.unique(triangles.object_index[triangles.is_emissive]))
    return f"{len(triangles)} triangles, {triangles.num_objects - lights} objects, {lights} lights"

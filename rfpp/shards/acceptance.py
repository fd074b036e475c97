"""Reject views that see too little surface or too little light, before rendering them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields

from rfpp.errors import UserError
from rfpp.ranges import Positive, Share
from rfpp.raycast.direct_light import direct_radiance
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera
from rfpp.shards.scene_rays import SceneRays

#: Reasons for rejecting a view, as counted in the index and the manifest.
EMPTY, UNLIT = "empty_views", "unlit_views"


@dataclass(frozen=True)
class Acceptance:
    """Criteria for views, checked on a small G-buffer with shadowed direct light."""

    resolution: Positive
    light_samples: Positive
    min_coverage: Share
    min_lit: Share
    min_radiance: float
    camera_attempts: Positive
    scene_attempts: Positive

    def __post_init__(self) -> None:
        for field in fields(self):
            value, least = getattr(self, field.name), int(not field.name.startswith("min_"))
            if field.name in ("min_coverage", "min_lit") and not 0 <= value <= 1:
                raise UserError(f"data.acceptance.{field.name} is {value}: use 0 to 1")
            if value < least:
                raise UserError(f"data.acceptance.{field.name} is {value}: use {least} or more")

    def cameras(
        self, rays: SceneRays, draw: Callable[[int], tuple[Camera, ...]], rejected: Counter[str]
    ) -> tuple[Camera, ...] | None:
        """Return the first accepted draw of each camera, or None if a camera has none."""
        accepted: dict[int, Camera] = {}
        for attempt in range(self.camera_attempts):
            cameras = draw(attempt)
            for view, camera in enumerate(cameras):
                if view in accepted:
                    continue
                if reason := self.objection(rays, camera):
                    rejected[reason] += 1
                else:
                    accepted[view] = camera
            if len(accepted) == len(cameras):
                return tuple(accepted[view] for view in range(len(cameras)))
        return None

    def objection(self, rays: SceneRays, camera: Camera) -> str | None:
        """Return EMPTY or UNLIT, or None for an acceptable view."""
        c2w = camera_to_world(camera)
        gbuffer = rays.first_hit(c2w, camera.fov, self.resolution)
        if not gbuffer.hit.any() or gbuffer.hit.mean() < self.min_coverage:
            return EMPTY
        lit = rays.with_direct_light(gbuffer, c2w, camera.fov, self.light_samples, seed=0)
        is_lit = lit.light.diffuse.any(axis=-1)[lit.hit].mean() >= self.min_lit
        is_bright = direct_radiance(lit, rays.triangles.material).mean() >= self.min_radiance
        return None if is_lit and is_bright else UNLIT

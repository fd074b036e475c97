"""Reject views that see too little or too little light, before rendering them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields

from rfpp.errors import UserError
from rfpp.raycast.direct_light import direct_radiance
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera
from rfpp.shards.scene_rays import SceneRays

#: Why a view is refused, as the index and the manifest count it.
EMPTY, UNLIT = "empty_views", "unlit_views"


@dataclass(frozen=True)
class Acceptance:
    """Criteria for views, checked on a small G-buffer with direct light and shadows.

    Attributes:
        resolution: pixels of that G-buffer.
        light_samples: shadow rays per light and pixel.
        min_coverage: share of the pixels that must see a surface.
        min_lit: share of these that some light must reach directly.
        min_radiance: mean outgoing radiance of direct light over all pixels.
        camera_attempts: draws of a camera, before its scene is drawn anew.
        scene_attempts: draws of a scene, before it counts as failed.
    """

    resolution: int
    light_samples: int
    min_coverage: float
    min_lit: float
    min_radiance: float
    camera_attempts: int
    scene_attempts: int

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("min_coverage", "min_lit") and not 0 <= value <= 1:
                raise UserError(f"data.acceptance.{field.name} is {value}: use 0 to 1")
            if value < (field.type == "int"):
                raise UserError(f"data.acceptance.{field.name} is {value}: use {int(field.type == 'int')} or more")

    def cameras(
        self, rays: SceneRays, draw: Callable[[int], tuple[Camera, ...]], refused: Counter[str]
    ) -> tuple[Camera, ...] | None:
        """The first accepted draw of each camera, or None if a camera has none.

        Args:
            draw: attempt → its cameras.
            refused: counts the refused views by reason.
        """
        accepted: dict[int, Camera] = {}
        for attempt in range(self.camera_attempts):
            cameras = draw(attempt)
            for view, camera in enumerate(cameras):
                if view in accepted:
                    continue
                if reason := self.objection(rays, camera):
                    refused[reason] += 1
                else:
                    accepted[view] = camera
            if len(accepted) == len(cameras):
                return tuple(accepted[view] for view in range(len(cameras)))
        return None

    def objection(self, rays: SceneRays, camera: Camera) -> str | None:
        """EMPTY or UNLIT, or None for a good view."""
        c2w = camera_to_world(camera)
        seen = rays.first_hit(c2w, camera.fov, self.resolution)
        if not seen.hit.any() or seen.hit.mean() < self.min_coverage:
            return EMPTY
        lit = rays.with_direct_light(seen, c2w, camera.fov, self.light_samples, seed=0)
        reached = lit.light.diffuse.any(axis=-1)[lit.hit].mean() >= self.min_lit
        bright = direct_radiance(lit, rays.triangles.material).mean() >= self.min_radiance
        return None if reached and bright else UNLIT

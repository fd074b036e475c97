"""G-buffers of views, cached: rays are not cast twice for the same answer."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from jaxtyping import Float

from rfpp.inference.bounded_cache import BoundedCache, digest_of
from rfpp.raycast.first_hit import DIRECT_CHANNELS, GBuffer, camera_caster, first_hit, stack_channels
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.raycast import RayCaster
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles

#: Memory of a triangle in Embree, about.
_BYTES_PER_TRIANGLE = 200
#: Memory of a triangle in a LightSampler.
_SAMPLER_BYTES_PER_TRIANGLE = 8
#: Memory of a pixel in a GBuffer: triangle, normal, depth and texel.
_BYTES_PER_PIXEL = 24


class GBufferSource:
    """Source of G-buffer channels that caches first hits and acceleration structures.

    First hits depend on geometry, on which triangles emit, and on the camera. New colors or another power of a light
    change none of them; materials are looked up and light is gathered anew for every G-buffer.

    Args:
        channels: Names from `rfpp.raycast.first_hit.CHANNELS`, in order.
    """

    def __init__(self, channels: Sequence[str], max_bytes: int = 1 << 30):
        self.channels = tuple(channels)
        self._cache: BoundedCache[GBuffer | RayCaster | LightSampler] = BoundedCache(max_bytes)

    def of(
        self, scene: PackedScene, height: int, width: int, light_samples: int, points: int = 1
    ) -> Callable[[int], Float[np.ndarray, "c h w"]]:
        """Return a function from view number to stacked channels; rays are cast when it is called.

        Args:
            light_samples: Shadow rays per light and pixel, divided among its samples; each has at least one.
            points: Samples along each side of a pixel; the channels are `points` times as high and wide.
        """
        if not self.channels:
            return lambda view: np.zeros((0, points * height, points * width), np.float32)

        def stacked(view: int) -> Float[np.ndarray, "c h w"]:
            gbuffer = self.gbuffer(scene, view, height, width, light_samples, points)
            return stack_channels(gbuffer, scene.triangles.material, scene.fov[view], self.channels)

        return stacked

    def gbuffer(
        self,
        scene: PackedScene,
        view: int,
        height: int,
        width: int,
        light_samples: int,
        points: int = 1,
        light: str | None = None,
        traced: bool = False,
    ) -> GBuffer:
        """Return the G-buffer of a view, with the light that `channels` need.

        Arguments are those of `of`, and the number of the camera, the object whose light alone counts (None for all
        lights), and whether to record derivatives by materials (`rfpp.raycast.traces`).
        """
        gbuffer = self.first_hit(scene, view, height, width, points)
        if not self._wants((*DIRECT_CHANNELS, "reflected_light")):
            return gbuffer
        per_sample = max(1, round(light_samples / points**2))
        lights = self.lights(scene.triangles, light)
        how = {"reflects": self._wants(["reflected_light"]), "traced": traced}
        return with_known_light(gbuffer, scene.c2w[view], scene.fov[view], lights, per_sample, **how)

    def first_hit(self, scene: PackedScene, view: int, height: int, width: int, points: int = 1) -> GBuffer:
        """Return the first hits of a view, without light; see `gbuffer`."""
        triangles, c2w, fov = scene.triangles, scene.c2w[view], scene.fov[view]
        height, width, geometry = points * height, points * width, geometry_digest(triangles)

        def cast() -> GBuffer:
            size = _BYTES_PER_TRIANGLE * len(triangles)
            caster = self._cache.get_or_compute(("camera", geometry), size, lambda: camera_caster(triangles))
            return first_hit(triangles, c2w, fov, height, width, caster, points)

        key = (geometry, c2w.tobytes(), float(fov), height, width, points)
        return self._cache.get_or_compute(key, _BYTES_PER_PIXEL * height * width, cast)

    def lights(self, triangles: SceneTriangles, light: str | None = None) -> LightSampler:
        """Return the sampler of all lights, or of one; it depends on all materials, which reflect."""
        key = ("lights", geometry_digest(triangles), digest_of(triangles.material))
        size = _SAMPLER_BYTES_PER_TRIANGLE * len(triangles)
        lights = self._cache.get_or_compute(key, size, lambda: LightSampler(triangles, self.shadow_caster(triangles)))
        return lights if light is None else lights.only(light)

    def shadow_caster(self, triangles: SceneTriangles) -> RayCaster:
        """Return a caster over all triangles, emitters included."""
        key, size = ("shadows", geometry_digest(triangles)), _BYTES_PER_TRIANGLE * len(triangles)
        return self._cache.get_or_compute(key, size, lambda: RayCaster(triangles.positions))

    def _wants(self, channels: Collection[str]) -> bool:
        return not set(self.channels).isdisjoint(channels)


def geometry_digest(triangles: SceneTriangles) -> bytes:
    """Return a digest of everything that rays depend on but the materials of triangles."""
    texels = b"" if triangles.texels is None else triangles.texels.digest
    return texels + digest_of(triangles.positions, triangles.normals, triangles.is_emissive, triangles.object_offsets)

"""Change lights without rendering again: images as sums over single lights."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from rfpp.inference.bounded_cache import BoundedCache, digest_of
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import EMISSION

Image = Float[np.ndarray, "h w 3"]
Size = tuple[int, int]
#: Number of views whose latest lights are remembered, to detect changes.
_MAX_VIEWS = 16


class LightMixer:
    """Renderer of a view that mixes the images of single lights once their emission changes."""

    def __init__(self, renderer: Renderer, max_bytes: int = 1 << 28):
        self._renderer = renderer
        #: View → powers of its lights, and the image of each light in white at this power.
        self._separated: BoundedCache[tuple[np.ndarray, np.ndarray]] = BoundedCache(max_bytes)
        self._latest: OrderedDict[bytes, bytes] = OrderedDict()

    def image(self, scene: PackedScene, size: Size, **sampling: int) -> Image:
        """Return the linear radiance of a scene with one camera, equal to `Renderer.views` up to rounding.

        `sampling` holds arguments of `Renderer.render`; they apply until the lights change, then its defaults do.
        """
        emission = _emission(scene)
        if emission is None:
            return next(self._renderer.views(scene, size, **sampling))
        view, lights = _digest(scene, size), emission.tobytes()
        separated = self._separated.get(view)
        if separated is None and self._latest.get(view, lights) != lights:
            separated = self._separate(scene, emission, size)
            self._separated.put(view, separated, separated[1].nbytes)
        if separated is not None:
            powers, images = separated
            mixed = np.einsum("lc,lhwc->hwc", emission / powers[:, None], images, dtype=np.float32)
            return self._renderer.refined(mixed[None], scene)[0]
        self._latest[view] = lights
        if len(self._latest) > _MAX_VIEWS:
            self._latest.popitem(last=False)
        return next(self._renderer.views(scene, size, **sampling))

    def is_separated(self, scene: PackedScene, size: Size) -> bool:
        """Return whether `image` needs no rendering."""
        return _emission(scene) is not None and self._separated.get(_digest(scene, size)) is not None

    def _separate(
        self, scene: PackedScene, emission: Float[np.ndarray, "l 3"], size: Size
    ) -> tuple[Float[np.ndarray, " l"], Float[np.ndarray, "l h w 3"]]:
        triangles, powers = scene.triangles, emission.max(-1)
        material = triangles.material.copy()
        for power, name in zip(powers, triangles.light_names, strict=True):
            material[triangles.object_index == triangles.object_names.index(name), EMISSION] = power
        images = self._renderer.render_lights(replace(scene, triangles=replace(triangles, material=material)), size)
        return powers, np.stack([of_light[0] for of_light in images.values()])


def _emission(scene: PackedScene) -> Float[np.ndarray, "l 3"] | None:
    """Return the radiance of each light; None if there is no light, or if one of them varies over its triangles."""
    triangles = scene.triangles
    owners = np.flatnonzero(np.bincount(triangles.object_index[triangles.is_emissive], minlength=triangles.num_objects))
    first = triangles.material[triangles.object_offsets[owners], EMISSION]
    emitted = triangles.material[np.isin(triangles.object_index, owners), EMISSION]
    is_constant = (emitted == np.repeat(first, np.diff(triangles.object_offsets)[owners], axis=0)).all()
    return first if len(owners) and is_constant and scene.texture is None else None


def _digest(scene: PackedScene, size: Size) -> bytes:
    """Return a digest of everything that an image depends on but the emission of lights."""
    triangles = scene.triangles
    surfaces = triangles.positions, triangles.normals, triangles.material[:, : EMISSION.start], triangles.is_emissive
    return digest_of(*surfaces, triangles.object_offsets, scene.c2w, scene.fov, np.array(size))

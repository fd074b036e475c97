"""Pictures of a scene whose lights change: sums of one image for each light, without a ray or a network."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from hashlib import blake2b

import numpy as np
from jaxtyping import Float

from rfpp.inference.bounded_cache import BoundedCache
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import EMISSION

Image = Float[np.ndarray, "h w 3"]
Size = tuple[int, int]
#: Views whose lights are remembered, to know when they change.
_REMEMBERED = 16


@dataclass(frozen=True, eq=False)
class _Apart:
    """Attributes:
    powers: of each light in `images`, where it is white.
    images: of the lights alone.
    """

    powers: Float[np.ndarray, " lights"]
    images: Float[np.ndarray, "lights h w 3"]


class LightMixer:
    """Renders a view as its renderer does, until a light of it changes: then each light apart, and from then on sums.

    Args:
        renderer: Renderer of a model that is linear in lights.
        max_bytes: of the images that are kept.
    """

    def __init__(self, renderer: Renderer, max_bytes: int = 1 << 28):
        self.renderer = renderer
        self._apart: BoundedCache[_Apart] = BoundedCache(max_bytes)
        self._before: OrderedDict[bytes, bytes] = OrderedDict()

    def image(self, scene: PackedScene, size: Size, **sampling: int) -> Image:
        """Linear radiance of a scene with one camera; to rounding that of `Renderer.views`.

        Args:
            sampling: of `Renderer.render`, while no light has changed; lights apart have the usual.
        """
        emitted = _emitted(scene)
        if emitted is None:  # a light of several colours is no factor times a white one
            return next(self.renderer.views(scene, size, **sampling))
        view, lights = _view(scene, size), emitted.tobytes()
        apart = self._apart.get(view)
        if apart is None and self._before.get(view, lights) != lights:
            apart = self._rendered(scene, emitted, size)
            self._apart.put(view, apart, apart.images.nbytes)
        if apart is not None:
            mixed = np.einsum("lc,lhwc->hwc", emitted / apart.powers[:, None], apart.images, dtype=np.float32)
            return self.renderer.refined(mixed[None], scene)[0]
        self._before[view] = lights
        if len(self._before) > _REMEMBERED:
            self._before.popitem(last=False)
        return next(self.renderer.views(scene, size, **sampling))

    def ready(self, scene: PackedScene, size: Size) -> bool:
        """Whether `image` has nothing to render."""
        return _emitted(scene) is not None and self._apart.get(_view(scene, size)) is not None

    def _rendered(self, scene: PackedScene, emitted: Float[np.ndarray, "lights 3"], size: Size) -> _Apart:
        """Every light in white, of the power it has: any colour is a factor of that."""
        triangles, powers = scene.triangles, emitted.max(-1)
        material = triangles.material.copy()
        for power, name in zip(powers, triangles.light_names, strict=True):
            material[triangles.object_index == triangles.object_names.index(name), EMISSION] = power
        white = replace(scene, triangles=replace(triangles, material=material))
        images = self.renderer.render_lights(white, size)
        return _Apart(powers, np.stack([of_light[0] for of_light in images.values()]))


def _emitted(scene: PackedScene) -> Float[np.ndarray, "lights 3"] | None:
    """Radiance of each light; None where there are none, or one whose triangles differ."""
    triangles = scene.triangles
    owners = np.flatnonzero(np.bincount(triangles.object_index[triangles.is_emissive], minlength=triangles.num_objects))
    first = triangles.material[triangles.object_offsets[owners], EMISSION]
    of_one = np.isin(triangles.object_index, owners)
    same = triangles.material[of_one, EMISSION] == np.repeat(first, np.diff(triangles.object_offsets)[owners], axis=0)
    return first if len(owners) and same.all() and scene.texture is None else None


def _view(scene: PackedScene, size: Size) -> bytes:
    """All that a picture depends on but what lights emit."""
    triangles, digest = scene.triangles, blake2b(f"{size}".encode(), digest_size=16)
    parts = (triangles.positions, triangles.normals, triangles.material[:, : EMISSION.start], triangles.is_emissive)
    for array in (*parts, triangles.object_offsets, scene.c2w, scene.fov):
        digest.update(np.ascontiguousarray(array))
    return digest.digest()

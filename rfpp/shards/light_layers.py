"""The light of a stored scene apart for each of its lights, and how it is stored.

All that a sample holds of light is linear in what its lights emit: known light and references alike. So any setting of
them is a weighted sum of these layers (`rfpp.shards.mixing`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from rfpp.radiosity.cells import Cells
from rfpp.raycast.first_hit import LIGHT_CHANNELS, GBuffer
from rfpp.imaging.exr import decode_exr, encode_exr
from rfpp.shards.whole import require_half_range

#: Of the scene, for every light; and of one view and light.
_SCENE, _VIEW = "lights.safetensors", "view{}.of_light{}.exr"


@dataclass(frozen=True, eq=False)
class LightLayers:
    """What each of L lights alone brings. Summed over lights, all are those of the sample, to rounding.

    Attributes:
        objects: [L] of the scene, ascending.
        images: [L, V, H, W, 3] references.
        known: name of `LIGHT_CHANNELS` → [L, V, H, W, 3] of the G-buffers.
        object_light: [L, O, 3] see `rfpp.raycast.object_light`.
        arriving, highlights: [L, C, 3] at cells, see `rfpp.radiosity.cells.Cells`.
    """

    objects: Int[np.ndarray, " l"]
    images: Float[np.ndarray, "l v h w 3"]
    known: Mapping[str, Float[np.ndarray, "l v h w 3"]]
    object_light: Float[np.ndarray, "l o 3"]
    arriving: Float[np.ndarray, "l c 3"]
    highlights: Float[np.ndarray, "l c 3"]

    @classmethod
    def of(
        cls,
        objects: Int[np.ndarray, " l"],
        images: Float[np.ndarray, "l v h w 3"],
        gbuffers: Sequence[Sequence[GBuffer]],
        object_light: Sequence[Float[np.ndarray, "o 3"]],
        cells: Sequence[Cells],
    ) -> LightLayers:
        """From what is known of the scene as each light alone lights it."""
        known = {name: np.array([[_light(g, name) for g in of] for of in gbuffers]) for name in LIGHT_CHANNELS}
        at_cells = (np.stack([getattr(of, name) for of in cells]) for name in ("arriving", "highlights"))
        return cls(objects, images, known, np.stack(object_light), *at_cells)


def _light(gbuffer: GBuffer, name: str) -> Float[np.ndarray, "h w 3"]:
    of = {
        "direct_diffuse": gbuffer.light.diffuse,
        "direct_glossy": gbuffer.light.glossy,
        "reflected_light": gbuffer.reflection.light,
        "bounced_light": gbuffer.cells.bounced,
    }
    return of[name]


def encode_lights(key: str, layers: LightLayers) -> dict[str, bytes]:
    """Member name → bytes. Raises ShardError naming the sample: a radiance beyond half precision."""
    of_scene = {
        "objects": layers.objects.astype(np.int32),
        **{name: getattr(layers, name).astype(np.float32) for name in ("object_light", "arriving", "highlights")},
    }
    members = {_SCENE: save_arrays({name: np.ascontiguousarray(a) for name, a in of_scene.items()})}
    for light, view in product(*map(range, layers.images.shape[:2])):
        stored = {"RGB": layers.images[light, view], **{name: of[light, view] for name, of in layers.known.items()}}
        for name, radiance in stored.items():
            require_half_range(radiance, f"{key}: view {view}: {name} of light {light}")
        members[_VIEW.format(view, light)] = encode_exr({name: a.astype(np.float16) for name, a in stored.items()})
    return members


def decode_lights(key: str, members: Mapping[str, bytes], views: Sequence[int]) -> LightLayers | None:
    """The inverse, of these views; None for a sample that was stored without.

    Raises:
        KeyError, ValueError, ImageFileError, SafetensorError: a member is missing or damaged.
    """
    if _SCENE not in members:
        return None
    of_scene = load_arrays(members[_SCENE])
    lights = range(len(of_scene["objects"]))

    def layers(light: int, view: int) -> dict[str, np.ndarray]:
        member = _VIEW.format(view, light)
        return decode_exr(members[member], f"{key}.{member}")

    decoded = [[layers(light, view) for view in views] for light in lights]

    def stacked(name: str) -> Float[np.ndarray, "l v h w 3"]:
        return np.stack([np.stack([view[name] for view in of]) for of in decoded]).astype(np.float32)

    return LightLayers(images=stacked("RGB"), known={name: stacked(name) for name in LIGHT_CHANNELS}, **of_scene)


def require_whole_lights(layers: LightLayers, images: np.ndarray, object_light: np.ndarray, cells: Cells) -> None:
    """Raises ValueError where layers do not fit what they are layers of."""
    fitting = [
        *((of, images) for of in (layers.images, *layers.known.values())),
        (layers.object_light, object_light),
        *((of, cells.arriving) for of in (layers.arriving, layers.highlights)),
    ]
    if any(of.shape != (len(layers.objects), *whole.shape) for of, whole in fitting):
        raise ValueError("layers are not of as many lights, views, objects or cells")
    objects = layers.objects
    if (np.diff(objects) <= 0).any() or (len(objects) and not 0 <= objects[0] <= objects[-1] < len(object_light)):
        raise ValueError("lights are not objects of the scene")

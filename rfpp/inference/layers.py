"""What a camera sees first, as layers of an EXR file that compositing programs know by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from rfpp.errors import UserError
from rfpp.imaging.exr import compact
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS

#: Layers whose values half precision would round visibly.
_FLOAT32 = ("depth", "position")


def checked_layers(names: Sequence[str]) -> tuple[str, ...]:
    """The names. Raises UserError at one that is no G-buffer channel, or that occurs twice."""
    if unknown := [name for name in names if name not in CHANNELS]:
        raise UserError(f"layers: '{unknown[0]}' does not exist: choose from {', '.join(CHANNELS)}")
    if len(set(names)) < len(names):
        raise UserError(f"layers: {list(names)} names one twice: give each once")
    return tuple(names)


def light_layers(images: Mapping[str, Float[np.ndarray, "h w 3"]]) -> dict[str, np.ndarray]:
    """What each light adds to an image, as layers of their own: light_lamp.R, …

    Args:
        images: by the names of lights, which may hold what layers' names may not.
    """
    layers: dict[str, Float[np.ndarray, "h w 3"]] = {}
    for number, (name, image) in enumerate(images.items()):
        layer = "light_" + re.sub(r"\W", "_", name)
        layers[f"{layer}_{number}" if layer in layers else layer] = image
    return _colours(layers)


def bounce_layers(images: Sequence[Float[np.ndarray, "h w 3"]]) -> dict[str, np.ndarray]:
    """What light adds to an image after one reflection, after two, …: bounce_01.R, … (in an order that sorts)."""
    return _colours({f"bounce_{number:02}": image for number, image in enumerate(images, start=1)})


def _colours(images: Mapping[str, Float[np.ndarray, "h w 3"]]) -> dict[str, np.ndarray]:
    return {
        f"{name}.{channel}": compact(image)[..., place]
        for name, image in images.items()
        for place, channel in enumerate("RGB")
    }


def exr_layers(stacked: Float[np.ndarray, "c h w"], names: Sequence[str]) -> dict[str, np.ndarray]:
    """G-buffer channels by the names of EXR files: albedo.R, normal.X, depth.Z, roughness.Y (luminance), …

    Args:
        stacked: of `rfpp.raycast.first_hit.stack_channels`.
        names: of its channels, in order.
    """
    layers: dict[str, np.ndarray] = {}
    planes = iter(stacked)
    for name in names:
        if name in COLOR_CHANNELS:
            components = "RGB"
        elif CHANNELS[name] == 3:
            components = "XYZ"
        else:
            components = "Z" if name == "depth" else "Y"
        dtype = np.float32 if name in _FLOAT32 else np.float16
        layers |= {f"{name}.{component}": next(planes).astype(dtype) for component in components}
    return layers

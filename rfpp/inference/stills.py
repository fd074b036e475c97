"""Files of single images: EXR with layers, PNG, and comparisons with path-traced references."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from rfpp.imaging.exr import compact, write_exr
from rfpp.imaging.panels import error_map, false_colors, panel, save_picture
from rfpp.imaging.tone_maps import ToneMap
from rfpp.metrics.flip import flip
from rfpp.raycast.first_hit import CHANNELS, COLOR_CHANNELS

Image = Float[np.ndarray, "h w 3"]
Layers = dict[str, np.ndarray]
Target = TypeVar("Target")
#: 8-bit values below which nothing is seen.
_DARK = 24
#: Channels that half precision would round visibly.
_FLOAT32 = ("depth", "position")


def write_still(image: Image, target: Path, tone_map: ToneMap, layers: Mapping[str, np.ndarray] | None = None) -> None:
    """Write linear radiance and further layers as EXR, and a tone-mapped PNG beside it. Raises UserError."""
    write_exr(target, {"RGB": compact(image), **(layers or {})})
    save_picture(tone_map(image), target.with_suffix(".png"))


def darkness(image: Image, tone_map: ToneMap) -> str | None:
    """Return how to brighten a picture in which even the brightest pixels are dark, or None."""
    if np.quantile(tone_map(image).max(axis=-1), 0.99) >= _DARK:
        return None
    if not (level := float(np.quantile(image.max(axis=-1), 0.99))) > 0:
        return "no light reaches what the camera sees: add a light there, or open the room"
    return f"99% of its pixels are almost black: try exposure={np.ceil(np.log2(0.5 / level)):.0f}, or add lights"


def write_comparison(
    image: Image, reference: Image, target: Path, tone_map: ToneMap, others: Mapping[str, Image] | None = None
) -> float:
    """Write the reference as `write_still` does, and a sheet of images and errors; return the mean ꟻLIP.

    File names are derived from `target`, the EXR file of the image; `others` are headings and images of the same view.
    """
    write_still(reference, target.with_name(f"{target.stem}_reference.exr"), tone_map)
    flip_map = flip(image, reference)
    columns = {
        "path-traced reference": [tone_map(reference)],
        "prediction": [tone_map(image)],
        "error": [error_map(image, reference)],
        f"FLIP, mean {flip_map.mean():.3f}": [false_colors(flip_map)],
    }
    for name, other in (others or {}).items():
        columns |= {name: [tone_map(other)], f"error of {name}": [error_map(other, reference)]}
    save_picture(panel(columns), target.with_name(f"{target.stem}_comparison.png"))
    return float(flip_map.mean())


def gbuffer_layers(stacked: Float[np.ndarray, "c h w"], names: Sequence[str]) -> Layers:
    """Return `stack_channels` under conventional names: albedo.R, normal.X, depth.Z, roughness.Y (luminance)."""
    layers, planes = {}, iter(stacked)
    for name in names:
        vector, number = "RGB" if name in COLOR_CHANNELS else "XYZ", "Z" if name == "depth" else "Y"
        components = vector if CHANNELS[name] == 3 else number
        dtype = np.float32 if name in _FLOAT32 else np.float16
        layers |= {f"{name}.{component}": next(planes).astype(dtype) for component in components}
    return layers


def light_layers(images: Mapping[str, Image]) -> Layers:
    """Return the image of each light, by name, as layers such as light_lamp.R."""
    named: dict[str, Image] = {}
    for number, (name, image) in enumerate(images.items()):
        layer = "light_" + re.sub(r"\W", "_", name)
        named[f"{layer}_{number}" if layer in named else layer] = image
    return _color_layers(named)


def bounce_layers(images: Sequence[Image]) -> Layers:
    """Return the light after one reflection, after two, … as layers such as bounce_01.R."""
    return _color_layers({f"bounce_{number:02}": image for number, image in enumerate(images, start=1)})


def _color_layers(images: Mapping[str, Image]) -> Layers:
    return {f"{name}.{c}": compact(image)[..., i] for name, image in images.items() for i, c in enumerate("RGB")}


def written_in_background(
    images: Iterable[Image], targets: Iterable[Target], write: Callable[[Image, Target], object]
) -> Iterator[Image]:
    """Yield the images while a thread writes each to its target; raise what `write` raises before the next but one."""
    with ThreadPoolExecutor(1, "writing") as executor:
        pending = None
        for image, target in zip(images, targets, strict=True):
            if pending:
                pending.result()
            pending = executor.submit(write, image, target)
            yield image
        if pending:
            pending.result()

"""Compare Cycles' presets, radiosity and a model with references by Mitsuba (`benchmark=outside`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from rfpp.benchmark.csv_rows import Row
from rfpp.benchmark.methods import ByCycles
from rfpp.benchmark.mitsuba_reference import render, sees_emitters
from rfpp.imaging.panels import panel, save_picture
from rfpp.imaging.tone_maps import SRGB
from rfpp.inference.renderer import Renderer
from rfpp.ranges import Positive
from rfpp.reference.cycles import CyclesSettings
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import pack

Image = Float[np.ndarray, "h w 3"]
#: Pixels along each side of the squares over which images are averaged before they are compared.
_SQUARE = 8
#: Mean radiance below which a view counts as dark.
_DARK = 1e-6


def measure(
    folder: Path | str,
    checkpoint: str,
    presets: Mapping[str, CyclesSettings],
    samples: Positive,
    resolution: Positive,
    picture: Path | str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per view and method.

    `energy` is Σx / Σy, `relative_l1` Σ|x - y| / Σy over means of 8 × 8 pixels; pixels that show a light are masked.
    For a dark view, `energy` is its mean radiance as a share of the scene's first view, and `relative_l1` is empty.

    Args:
        folder: Scenes, as RenderFormer JSON.
        checkpoint: Model that `Renderer.load` accepts, linear in lights.
        presets: Name → settings of Cycles.
        samples: Paths per pixel of the references.
        resolution: Pixels along both sides, a multiple of 8.
        picture: PNG or JPEG file for a sheet of all views, or None.
        progress: Called with (images rendered, all images).
    """
    scenes = [pack(load_scene(path)) for path in sorted(Path(folder).glob("*.json"))]
    renderer = Renderer.load(checkpoint)
    sheet: dict[str, list[Image]] = {}
    done, total = 0, len(scenes) * (1 + len(presets) + 1)
    for scene in scenes:
        reference = render(scene, resolution, samples)
        progress(done := done + 1, total)
        images: dict[str, Float[np.ndarray, "v h w 3"]] = {}
        for name, preset in presets.items():
            [[(images[f"Cycles, {name}"], _)]] = ByCycles(preset)([[scene]], resolution)
            progress(done := done + 1, total)
        unrefined = np.stack(list(renderer.fresh().views(scene, resolution, is_refined=False)))
        images |= {"radiosity, unrefined": unrefined, checkpoint: renderer.refined(unrefined, scene)}
        progress(done := done + 1, total)
        for view in range(len(scene.fov)):
            masked = sees_emitters(scene, view, resolution)
            for method, pictures in images.items():
                yield {"scene": scene.name, "view": view, "method": method} | _agreement(
                    pictures[view], reference[view], masked, reference[0]
                )
            for method, pictures in {"Mitsuba": reference, **images}.items():
                sheet.setdefault(method, []).append(pictures[view])
    if picture:
        save_picture(panel({method: [SRGB()(image) for image in of] for method, of in sheet.items()}), Path(picture))


def _agreement(image: Image, reference: Image, masked: Bool[np.ndarray, "h w"], lit: Image) -> Row:
    if reference.mean() < _DARK:
        return {"energy": float(image.mean() / lit.mean()), "relative_l1": None}
    image, reference = (np.where(masked[..., None], 0, x).astype(np.float64) for x in (image, reference))
    energy = image.sum() / reference.sum()
    difference = np.abs(_means(image) - _means(reference)).sum() / _means(reference).sum()
    return {"energy": float(energy), "relative_l1": float(difference)}


def _means(image: Image) -> Float[np.ndarray, "rows columns 3"]:
    rows, columns = (side // _SQUARE for side in image.shape[:2])
    return image.reshape(rows, _SQUARE, columns, _SQUARE, 3).mean((1, 3))

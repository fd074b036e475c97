"""The pictures of one view as files: what was rendered, and how it compares with a path-traced reference."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.imaging.exr import compact, write_exr
from rfpp.imaging.panels import error_map, false_colours, panel, save_picture
from rfpp.imaging.tone_maps import ToneMap
from rfpp.metrics.flip import flip

Image = Float[np.ndarray, "h w 3"]


def write_still(image: Image, target: Path, tone_map: ToneMap, layers: Mapping[str, np.ndarray] | None = None) -> None:
    """Linear radiance as EXR with further layers, half floats where they hold it, and tone-mapped as PNG beside it.

    Raises:
        UserError: a file cannot be written.
    """
    write_exr(target, {"RGB": compact(image), **(layers or {})})
    save_picture(tone_map(image), target.with_suffix(".png"))


def write_comparison(
    image: Image, reference: Image, target: Path, tone_map: ToneMap, others: Mapping[str, Image] | None = None
) -> float:
    """The reference as files like those of the image, and a sheet of both with their errors; returns the ꟻLIP.

    Args:
        others: heading → another image of the same view, to stand beside with its error.

    Raises:
        UserError: a file cannot be written.
    """
    write_still(reference, target.with_name(f"{target.stem}_reference.exr"), tone_map)
    seen = flip(image, reference)
    columns = {
        "path-traced reference": [tone_map(reference)],
        "prediction": [tone_map(image)],
        "error": [error_map(image, reference)],
        f"FLIP, mean {seen.mean():.3f}": [false_colours(seen)],
    }
    for name, other in (others or {}).items():
        columns |= {name: [tone_map(other)], f"error of {name}": [error_map(other, reference)]}
    save_picture(panel(columns), target.with_name(f"{target.stem}_comparison.png"))
    return float(seen.mean())

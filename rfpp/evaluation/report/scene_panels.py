"""Pictures of predictions, and sheets of the best, median and worst scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from rfpp.evaluation.measuring.evaluate import RenderedScene
from rfpp.imaging.panels import Picture, error_map, panel, save_picture, tone_mapped
from rfpp.metrics.baselines import DirectLightAlone

_COLUMNS = ("reference", "prediction", "error", "albedo")


def first_view(scene: RenderedScene) -> dict[str, Picture]:
    """The scene's first view as 8-bit pictures: reference, prediction, error, direct light, albedo."""
    reference, prediction = _image(scene.reference), _image(scene.prediction)
    return {
        "reference": tone_mapped(reference),
        "prediction": tone_mapped(prediction),
        "error": error_map(prediction, reference),
        "direct light": tone_mapped(_image(DirectLightAlone().predict(scene.gbuffer))),
        "albedo": tone_mapped(_image(scene.gbuffer["albedo"])),
    }


def save_scene_panel(scenes: Mapping[str, Mapping[str, Picture]], path: Path) -> Path:
    """One row per scene: reference | prediction | error | albedo; returns the PNG's path.

    Args:
        scenes: caption of the row → its `first_view`.

    Raises:
        UserError: the file cannot be written.
    """
    columns = {name: [pictures[name] for pictures in scenes.values()] for name in _COLUMNS}
    return save_picture(panel(columns, captions=list(scenes)), path)


def _image(views: Float[Tensor, "v 3 h w"]) -> Float[np.ndarray, "h w 3"]:
    return views[0].permute(1, 2, 0).cpu().numpy()

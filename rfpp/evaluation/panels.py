"""Pictures of the scenes on which a network does best, middling and worst."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rfpp.evaluation.evaluate import RenderedScene
from rfpp.panels import error_map, panel, save_png, tone_mapped


def save_scene_panel(scenes: Mapping[str, RenderedScene], path: Path) -> Path:
    """One row per scene, its first view: reference | prediction | error | albedo; returns the PNG's path.

    Args:
        scenes: caption of the row → scene.

    Raises:
        UserError: the file cannot be written.
    """
    references, predictions, albedos = (
        [views[0].permute(1, 2, 0).cpu().numpy() for views in of_all]
        for of_all in zip(*((s.reference, s.prediction, s.gbuffer["albedo"]) for s in scenes.values()), strict=True)
    )
    columns = {
        "reference": [tone_mapped(reference) for reference in references],
        "prediction": [tone_mapped(prediction) for prediction in predictions],
        "error": [error_map(p, r) for p, r in zip(predictions, references, strict=True)],
        "albedo": [tone_mapped(albedo) for albedo in albedos],
    }
    return save_png(panel(columns, captions=list(scenes)), path)

"""Scores per image and per scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

#: The name of the network in records.
MODEL = "model"

Values = Mapping[str, float]


@dataclass(frozen=True)
class ImageRecord:
    """Scores of one predictor on one image.

    Attributes:
        split, scene, view: which image.
        triangles, objects, lights: in its scene; every light is an object too.
        predictor: "model" or the name of a baseline.
        values: by metric name.
    """

    split: str
    scene: str
    view: int
    triangles: int
    objects: int
    lights: int
    predictor: str
    values: Values


@dataclass(frozen=True)
class SceneRecord:
    """Scores of one predictor on one scene: means over its views.

    Attributes: those of an `ImageRecord`, but for the view.
    """

    split: str
    scene: str
    triangles: int
    objects: int
    lights: int
    predictor: str
    values: Values


def scene_records(records: Iterable[ImageRecord]) -> list[SceneRecord]:
    """One record per split, predictor and scene, in the order of their first images."""
    grouped = defaultdict(list)
    for r in records:
        grouped[r.split, r.scene, r.triangles, r.objects, r.lights, r.predictor].append(r.values)
    return [SceneRecord(*key, _mean(values)) for key, values in grouped.items()]


def _mean(group: Sequence[Values]) -> dict[str, float]:
    return {name: sum(values[name] for values in group) / len(group) for name in group[0]}

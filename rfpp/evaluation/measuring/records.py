"""Scores of one predictor on one scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

#: Name of the evaluated checkpoint in records.
MODEL = "model"


@dataclass(frozen=True)
class SceneRecord:
    """Scores of one predictor on one scene.

    Attributes:
        predictor: "model" or the name of a baseline.
        views: Value by metric name, for each view.
    """

    split: str
    scene: str
    triangles: int
    objects: int
    lights: int
    predictor: str
    views: Sequence[Mapping[str, float]]

    @property
    def values(self) -> dict[str, float]:
        """Means over the views, by metric name."""
        return {name: sum(view[name] for view in self.views) / len(self.views) for name in self.views[0]}

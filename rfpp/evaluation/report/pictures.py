"""Pictures of predictions: the best, median and worst scene of a split, and scenes evenly between them."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from rfpp.evaluation.measuring.number_text import number_text
from rfpp.evaluation.measuring.predictors import Predictor, StoredScene
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.imaging.panels import Picture, error_map, panel, save_picture, tone_mapped
from rfpp.metrics.baselines import DirectLight
from rfpp.metrics.image import METRICS
from rfpp.shards.dataset import ShardSplit

#: Metric that ranks scenes; lower is better.
RANKED_BY = "log_l1"
#: Pictured scenes per split, at most.
_COUNT = 9
#: Pixels along the longer side of an embedded picture; larger pictures are shrunk.
MAX_PIXELS = 256
_PANEL_COLUMNS = ("reference", "prediction", "error", "albedo")


@dataclass(frozen=True, eq=False)
class PicturedScene:
    """A scene with its scores, rank and pictures.

    Attributes:
        rank: Rank in the split by `RANKED_BY`; 0 is the best.
        pictures: First view by name: reference, prediction, error, direct light, albedo.
    """

    record: SceneRecord
    rank: int
    scenes: int
    pictures: Mapping[str, Picture]

    @property
    def places(self) -> list[str]:
        """Return which of best, median and worst the scene is."""
        return [place for place, rank in _places(self.scenes).items() if rank == self.rank]


@torch.no_grad()
def pictured_scenes(
    records: Sequence[SceneRecord], predictor: Predictor, split: ShardSplit, device: torch.device
) -> list[PicturedScene]:
    """Picture scenes of a split, best first.

    Args:
        records: The predictor's records of the whole split, in its order.
    """
    order = ranking(records)
    pictured = []
    for rank in pictured_ranks(len(records)):
        scene = StoredScene.of(split[order[rank]], device)
        pictures = _pictures(scene, predictor.predict(scene))
        pictured.append(PicturedScene(records[order[rank]], rank, len(records), pictures))
    return pictured


def ranking(records: Sequence[SceneRecord]) -> list[int]:
    """Return indices of one predictor's records from best to worst. NaN is worse than any number."""
    errors = [record.values[RANKED_BY] for record in records]
    return sorted(range(len(errors)), key=lambda index: (math.isnan(errors[index]), errors[index]))


def pictured_ranks(scenes: int) -> list[int]:
    """Return the ranks of the pictured scenes: best, median and worst, and ranks evenly between them."""
    best, median, worst = _places(scenes).values()
    half = (_COUNT + 1) // 2
    ranks = np.concatenate([np.linspace(best, median, half), np.linspace(median, worst, half)])
    return np.unique(ranks.round().astype(int)).tolist()


def save_panel(scenes: Sequence[PicturedScene], path: Path) -> Path:
    """Save a PNG with one row for the best, median and worst scene: reference | prediction | error | albedo."""
    rows = {place: scene for scene in scenes for place in scene.places}
    columns = {name: [scene.pictures[name] for scene in rows.values()] for name in _PANEL_COLUMNS}
    label = METRICS[RANKED_BY].label
    captions = [
        f"{place}: {s.record.scene}, {label} {number_text(RANKED_BY, s.record.values[RANKED_BY])}"
        for place, s in rows.items()
    ]
    return save_picture(panel(columns, captions=captions), path)


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture for a page.

    Attributes:
        uri: Data URI with the picture as lossless WebP.
    """

    uri: str
    width: int
    height: int

    @classmethod
    def of(cls, picture: Picture) -> EmbeddedPicture:
        """Encode a picture, downscaled to `MAX_PIXELS`."""
        image, stream = Image.fromarray(np.ascontiguousarray(picture)), io.BytesIO()
        image.thumbnail((MAX_PIXELS, MAX_PIXELS), Image.Resampling.BOX)
        image.save(stream, format="webp", lossless=True)
        return cls(f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode()}", *image.size)


def _places(scenes: int) -> dict[str, int]:
    return {"best": 0, "median": scenes // 2, "worst": scenes - 1}


def _pictures(scene: StoredScene, radiance: Float[Tensor, "v 3 h w"]) -> dict[str, Picture]:
    reference, prediction = _first(scene.reference), _first(radiance)
    return {
        "reference": tone_mapped(reference),
        "prediction": tone_mapped(prediction),
        "error": error_map(prediction, reference),
        "direct light": tone_mapped(_first(DirectLight().predict(scene.gbuffer))),
        "albedo": tone_mapped(_first(scene.gbuffer["albedo"])),
    }


def _first(views: Float[Tensor, "v 3 h w"]) -> Float[np.ndarray, "h w 3"]:
    return views[0].permute(1, 2, 0).cpu().numpy()

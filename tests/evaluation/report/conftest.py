"""A report with known numbers and plain pictures."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rfpp.evaluation.measuring.confidence import split_estimates
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.evaluation.report.evaluation_report import write_report
from rfpp.evaluation.report.pictures import PicturedScene, pictured_ranks, ranking
from rfpp.metrics.image import METRICS

RED, BLUE = (255, 0, 0), (0, 0, 255)
COLOURS = {"reference": BLUE, "prediction": RED, "error": (90, 20, 90), "direct light": RED, "albedo": BLUE}


@pytest.fixture
def reported(evaluation, bootstrap, tmp_path) -> Callable[..., Path]:
    """`reported({scene: (triangles, log-L1)}, ...)`: the report of a model with these scores on split test.

    PSNR is 30 − 10 log-L1, the baseline's log-L1 0.9. Predictions are red, references blue.
    """

    def written(scenes: dict[str, tuple[int, float]], baseline: str = "black", **about) -> Path:
        records = [
            SceneRecord("test", scene, triangles, 7, 2, who, 2 * [{"log_l1": error, "psnr": 30 - 10 * level}])
            for who in ("model", baseline)
            for scene, (triangles, level) in scenes.items()
            for error in [level if who == "model" else 0.9]
        ]
        definitions = {name: METRICS[name].definition for name in ("log_l1", "psnr")}
        measured = evaluation(means=split_estimates(records, bootstrap), definitions=definitions, **about)
        pictures = {name: np.full((32, 32, 3), color, np.uint8) for name, color in COLOURS.items()}
        order = ranking(records[: len(scenes)])
        ranks = pictured_ranks(len(scenes))
        pictured = [PicturedScene(records[order[rank]], rank, len(scenes), pictures) for rank in ranks]
        return write_report(measured, records, pictured, tmp_path)

    return written

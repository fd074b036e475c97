"""A small data set, a network with known predictions, and known results."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from browser import _chromium, browser  # noqa: F401
from small_data import make
from torch import nn

from rfpp.evaluation.measuring.confidence import Bootstrap, Estimate
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.predictors import NetworkPredictor
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.evaluation.tables.paper import PAPER_METRICS
from rfpp.imaging.radiance import log_encode
from rfpp.metrics.image import METRICS
from rfpp.shards.dataset import ShardSplit

CPU = torch.device("cpu")


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    return make(tmp_path_factory.mktemp("known"), name="known", splits={"train": 2, "test": 3}, resolution=16).root


@pytest.fixture
def test_split(data_root) -> ShardSplit:
    return ShardSplit(data_root, "test")


class HalfAlbedo(nn.Module):
    """A network that predicts half the albedo and checks its input channels."""

    gbuffer_channels = ("roughness", "albedo")
    patch_size = 4

    def forward(self, batch) -> SimpleNamespace:
        assert batch.gbuffer.shape[2] == 4
        return SimpleNamespace(log_radiance=log_encode(0.5 * batch.gbuffer[:, :, 1:4]))


@pytest.fixture
def half_albedo() -> NetworkPredictor:
    return NetworkPredictor(HalfAlbedo(), CPU)


def record(split: str, scene: str, triangles: int, predictor: str, *views: tuple[float, float]) -> SceneRecord:
    """A record whose views have these values of log-L1 and PSNR."""
    values = [{"log_l1": error, "psnr": psnr} for error, psnr in views]
    return SceneRecord(split, scene, triangles, 7, 2, predictor, values)


@pytest.fixture(scope="session")
def records() -> list[SceneRecord]:
    """Two scenes of test and one of train_newviews."""
    return [
        record("test", "a", 500, "model", (0.1, 30.0), (0.3, 20.0)),
        record("test", "b", 2000, "model", (0.4, 10.0)),
        record("test", "a", 500, "black", (0.5, 35.0), (0.5, 35.0)),
        record("test", "b", 2000, "black", (0.7, 35.0)),
        record("train_newviews", "c", 500, "model", (0.05, 33.0)),
    ]


@pytest.fixture(scope="session")
def bootstrap() -> Bootstrap:
    return Bootstrap(resamples=2000, seed=0)


@pytest.fixture(scope="session")
def evaluation() -> Callable[..., Evaluation]:
    """`evaluation(...)`: every metric of the model is `level` with an interval of ± 0.02, and 0.9 for black."""
    return _evaluation


def _evaluation(
    method="RenderFormer++", data="small_scale", seed=0, level=0.1, splits=("train_newviews", "test"), **changes
) -> Evaluation:
    model = {name: Estimate(level, level - 0.02, level + 0.02, 50) for name in PAPER_METRICS}
    black = dict.fromkeys(PAPER_METRICS, Estimate(0.9, 0.8, 1.0, 50))
    about = {
        "trained_on": data,
        "steps": 27_000,
        "commit": "abcdef123456",
        "data_manifest": f"hash of {data}",
        "hardware": "a machine, 2 cores",
        "definitions": {name: METRICS[name].definition for name in PAPER_METRICS},
        "means": {(split, who): values for split in splits for who, values in (("model", model), ("black", black))},
    }
    return Evaluation(method=method, data=data, seed=seed, **(about | changes))

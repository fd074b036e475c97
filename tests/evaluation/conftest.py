"""A data set whose every image is half its albedo, a network whose answers are known, and known results."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from browser import _chromium, browser  # noqa: F401
from known_scenes import look_at, still_life
from torch import nn

from rfpp.evaluation.measuring.buckets import bucketed
from rfpp.evaluation.measuring.confidence import Bootstrap, Estimate, split_estimates
from rfpp.evaluation.measuring.csv_files import write_buckets, write_records
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.records import ImageRecord, SceneRecord, scene_records
from rfpp.evaluation.report.picture_archive import write_pictures
from rfpp.evaluation.tables.paper import PAPER_METRICS
from rfpp.raycast.first_hit import stack_channels
from rfpp.imaging.radiance import log_encode
from rfpp.metrics.image import METRICS
from rfpp.model.renderformer_pp import Rendering
from rfpp.shards.manifest import MANIFEST_FILE, manifest_json
from rfpp.shards.sample import SceneSample, encode
from rfpp.shards.scene_rays import SceneRays
from rfpp.shards.tar import pack
from rfpp.shards.writer import ShardWriter, write_json

SIZE = 16
POSES = [look_at((0.9, 0.2, 0.9)), look_at((-0.3, -1.0, 0.8))]


def _sample(key: str, seed: int, brightness: float) -> SceneSample:
    triangles = still_life(seed)
    fov = np.full(len(POSES), 45.0, np.float32)
    gbuffers = SceneRays(triangles).gbuffers(np.stack(POSES), fov, SIZE, 1, np.random.SeedSequence(0))
    albedo = [stack_channels(g, triangles.material, 45.0, ["albedo"]).transpose(1, 2, 0) for g in gbuffers]
    return SceneSample(
        key=key,
        triangles=triangles,
        c2w=np.stack(POSES).astype(np.float32),
        fov=fov,
        images=(brightness * np.stack(albedo)).astype(np.float16).astype(np.float32),
        gbuffers=gbuffers,
        meta={},
    )


def _write_split(root: Path, split: str, brightness: list[float]):
    writer = ShardWriter(root, f"{split}-00000.tar", "fingerprint")
    for index, level in enumerate(brightness):
        key = f"{split}-{index:06d}"
        blocks = pack(key, encode(_sample(key, index, level)))
        writer.add(key, blocks, triangles=100, objects=5, scene_redraws=0, empty_views=0, unlit_views=0)
    return writer.commit()


@pytest.fixture(scope="session")
def data_root(tmp_path_factory) -> Path:
    """Training images are 0.5 albedo; the test scenes 0.5, 0.6 and 0.9 albedo."""
    root = tmp_path_factory.mktemp("known-data")
    levels = {"train": [0.5, 0.5], "test": [0.6, 0.5, 0.9]}
    splits = {split: [_write_split(root, split, values)] for split, values in levels.items()}
    write_json(root / MANIFEST_FILE, manifest_json("known", {}, len(POSES), splits))
    return root


class HalfAlbedo(nn.Module):
    """A network that predicts half the albedo, and checks that it is given what it asked for."""

    gbuffer_channels = ("roughness", "albedo")
    patch_size = 4

    def forward(self, batch) -> Rendering:
        assert batch.gbuffer.shape[2] == 4
        return Rendering(log_encode(0.5 * batch.gbuffer[:, :, 1:4]), ())


@pytest.fixture
def half_albedo() -> nn.Module:
    return HalfAlbedo()


@pytest.fixture
def cpu() -> torch.device:
    return torch.device("cpu")


def _record(
    split: str, scene: str, view: int, predictor: str, log_l1: float, psnr: float, triangles: int = 500
) -> ImageRecord:
    return ImageRecord(split, scene, view, triangles, 7, 2, predictor, {"log_l1": log_l1, "psnr": psnr})


@pytest.fixture(scope="session")
def images() -> list[ImageRecord]:
    """Two scenes of test, of 500 and of 2000 triangles, and one of train_newviews, of 500."""
    return [
        _record("test", "a", 0, "model", 0.1, 30.0),
        _record("test", "a", 1, "model", 0.3, 20.0),
        _record("test", "b", 0, "model", 0.4, 10.0, triangles=2000),
        _record("test", "a", 0, "black", 0.5, 35.0),
        _record("test", "a", 1, "black", 0.5, 35.0),
        _record("test", "b", 0, "black", 0.7, 35.0, triangles=2000),
        _record("train_newviews", "c", 0, "model", 0.05, 33.0),
    ]


@pytest.fixture(scope="session")
def scenes(images) -> list[SceneRecord]:
    return scene_records(images)


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


RED, BLUE = (255, 0, 0), (0, 0, 255)


@pytest.fixture
def evaluated(evaluation, bootstrap, tmp_path) -> Callable[..., Path]:
    """`evaluated({scene: (triangles, log-L1)}, ...)`: the folder of an evaluation whose model scored so on split test.

    PSNR is 30 − 10 log-L1, the baseline's log-L1 0.9. All scenes have pictures: predictions are red, references blue.
    """

    def written(scenes: dict[str, tuple[int, float]], baseline: str = "black", **about) -> Path:
        images = [
            _record("test", scene, view, who, error if who == "model" else 0.9, 30 - 10 * error, triangles)
            for who in ("model", baseline)
            for scene, (triangles, error) in scenes.items()
            for view in range(2)
        ]
        records = scene_records(images)
        definitions = {name: METRICS[name].definition for name in ("log_l1", "psnr")}
        means = split_estimates(records, bootstrap)
        evaluation(means=means, definitions=definitions, **about).write(tmp_path)
        write_records(images, records, tmp_path)
        write_buckets(bucketed(records, {"triangles": [1000], "objects": [5]}, bootstrap), tmp_path)
        plain = {"prediction": RED, "reference": BLUE, "error": (90, 20, 90), "direct light": RED, "albedo": BLUE}
        tiles = {name: np.full((32, 32, 3), colour, np.uint8) for name, colour in plain.items()}
        write_pictures({("test", scene): tiles for scene in scenes}, tmp_path)
        return tmp_path

    return written

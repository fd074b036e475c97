import pytest
import torch

from rfpp.errors import ShardError
from rfpp.evaluation.measuring.evaluate import score
from rfpp.evaluation.measuring.predictors import StoredScene
from rfpp.evaluation.measuring.records import MODEL
from rfpp.imaging.radiance import log_encode
from rfpp.metrics.image import ImageMetrics
from rfpp.shards.dataset import ShardSplit

METRICS, CPU = ImageMetrics(lpips=None), torch.device("cpu")


def test_values_are_those_of_each_view(test_split, half_albedo) -> None:
    scene = StoredScene.of(test_split[1], CPU)
    record = score([half_albedo], test_split, METRICS, CPU)[1]
    error = (log_encode(half_albedo.predict(scene)) - log_encode(scene.reference)).abs().mean(dim=(1, 2, 3))
    assert (record.scene, record.predictor) == (scene.sample.key, MODEL)
    assert [view["log_l1"] for view in record.views] == pytest.approx(error.tolist(), rel=1e-5)
    assert record.values["log_l1"] == pytest.approx(error.mean().item(), rel=1e-5)


def test_a_record_holds_the_size_of_its_scene(test_split, half_albedo) -> None:
    sizes = {(r.triangles, r.objects, r.lights) for r in score([half_albedo], test_split, METRICS, CPU)}
    assert sizes == {(2 + 4 + 1, 3, 1)}


def test_an_empty_split_is_named(data_root, half_albedo) -> None:
    class Empty(ShardSplit):
        def __len__(self) -> int:
            return 0

    with pytest.raises(ShardError, match="'test' is empty"):
        score([half_albedo], Empty(data_root, "test"), METRICS, CPU)

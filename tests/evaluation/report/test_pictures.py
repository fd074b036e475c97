import base64
import io

import numpy as np
import pytest
import torch
from PIL import Image

from rfpp.evaluation.measuring.evaluate import score
from rfpp.evaluation.measuring.predictors import StoredScene
from rfpp.evaluation.report.pictures import (
    MAX_PIXELS,
    EmbeddedPicture,
    pictured_ranks,
    pictured_scenes,
    save_panel,
)
from rfpp.imaging.panels import tone_mapped
from rfpp.metrics.image import ImageMetrics

CPU = torch.device("cpu")


@pytest.mark.parametrize("scenes", [1, 2, 3, 9, 32, 1000])
def test_best_median_and_worst_are_among_the_pictured(scenes) -> None:
    ranks = pictured_ranks(scenes)
    assert ranks == sorted(set(ranks))
    assert {0, scenes // 2, scenes - 1} <= set(ranks)
    assert len(ranks) == min(scenes, 9)


def test_pictures_show_the_first_view_of_the_ranked_scenes(test_split, half_albedo, tmp_path) -> None:
    records = score([half_albedo], test_split, ImageMetrics(lpips=None), CPU)
    pictured = pictured_scenes(records, half_albedo, test_split, CPU)
    assert [scene.places for scene in pictured] == [["best"], ["median"], ["worst"]]
    errors = [scene.record.values["log_l1"] for scene in pictured]
    assert errors == sorted(record.values["log_l1"] for record in records)
    worst = StoredScene.of(test_split[records.index(pictured[-1].record)], CPU)
    expected = {
        "reference": worst.reference,
        "prediction": half_albedo.predict(worst),
        "albedo": worst.gbuffer["albedo"],
    }
    for name, views in expected.items():
        image = tone_mapped(views[0].permute(1, 2, 0).numpy())
        np.testing.assert_array_equal(pictured[-1].pictures[name], image)
    assert save_panel(pictured, tmp_path / "new" / "test.png").read_bytes().startswith(b"\x89PNG")


def test_embedded_pictures_are_lossless_and_bounded() -> None:
    noise = np.random.default_rng(0).integers(256, size=(24, 40, 3), dtype=np.uint8)
    small, large = EmbeddedPicture.of(noise), EmbeddedPicture.of(noise.repeat(20, 0).repeat(20, 1))
    decoded = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(picture.uri.partition("base64,")[2]))))
        for picture in (small, large)
    ]
    np.testing.assert_array_equal(decoded[0], noise)
    assert max(decoded[1].shape) == max(large.width, large.height) == MAX_PIXELS

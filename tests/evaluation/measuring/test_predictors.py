import numpy as np
import pytest
import torch

from rfpp.errors import UserError
from rfpp.evaluation.measuring.predictors import (
    RendererPredictor,
    StoredScene,
    fitted_baselines,
    predictor_of,
)
from rfpp.imaging.radiance import log_decode, log_encode
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import select_views


@pytest.fixture
def scene(test_split) -> StoredScene:
    return StoredScene.of(test_split[0], torch.device("cpu"))


def test_a_network_reads_the_stored_channels_it_asks_for(scene, half_albedo) -> None:
    albedo = select_views(scene.sample, range(2), ("albedo",)).gbuffer
    torch.testing.assert_close(half_albedo.predict(scene), torch.from_numpy(0.5 * albedo))


def test_a_resolution_that_is_no_multiple_of_the_patch_size_is_one_line(scene, half_albedo) -> None:
    half_albedo.network.patch_size = 5
    with pytest.raises(UserError, match="test-000000: 16x16 pixels .* patch size 5") as error:
        half_albedo.predict(scene)
    assert "\n" not in str(error.value)


def test_radiosity_renders_the_stored_triangles_and_cameras(scene) -> None:
    renderer = Renderer.load("radiosity", "cpu", "fp32")
    predictor = predictor_of(renderer)
    sample = scene.sample
    packed = PackedScene("another name", sample.triangles, sample.c2w, sample.fov)
    images = torch.from_numpy(renderer.fresh().render(packed, (16, 16))).permute(0, 3, 1, 2)
    assert images.max() > 0
    assert isinstance(predictor, RendererPredictor)
    torch.testing.assert_close(predictor.predict(scene), images)


def test_baselines_are_fitted_on_the_training_split(scene, data_root) -> None:
    train = ShardSplit(data_root, "train")
    predictions = {baseline.name: baseline.predict(scene) for baseline in fitted_baselines(train, 10)}
    names = ["black", "mean image", "albedo x constant", "direct light", "direct light and reflections"]
    assert list(predictions) == names
    images = torch.from_numpy(np.concatenate([train[index].images for index in range(2)])).permute(0, 3, 1, 2)
    expected = log_decode(log_encode(images).mean(dim=0)).expand(2, 3, 16, 16)
    torch.testing.assert_close(predictions["mean image"], expected, rtol=1e-4, atol=1e-6)

import numpy as np
import pytest
import torch

from rfpp.errors import ShardError, UserError
from rfpp.evaluation.measuring.evaluate import baseline_records, fitted_baselines, network_records, render_stored
from rfpp.evaluation.measuring.records import MODEL, SceneRecord, scene_records
from rfpp.evaluation.report.ranking import pictured_scenes, ranked_scenes
from rfpp.evaluation.report.scene_panels import first_view, save_scene_panel
from rfpp.imaging.radiance import log_encode
from rfpp.metrics.image import ImageMetrics
from rfpp.shards.dataset import ShardSplit


@pytest.fixture
def of_network(data_root, half_albedo, cpu):
    return network_records(half_albedo, ShardSplit(data_root, "test"), ImageMetrics(lpips=None), cpu, lambda: None)


@pytest.fixture
def records(data_root, of_network, cpu):
    test, baselines = ShardSplit(data_root, "test"), fitted_baselines(ShardSplit(data_root, "train"), 10)
    return of_network + baseline_records(baselines, test, ImageMetrics(lpips=None), cpu, lambda: None)


def test_every_image_is_recorded_once_for_every_predictor(records) -> None:
    identities = [(r.scene, r.view, r.predictor) for r in records]
    assert len(identities) == len(set(identities)) == 3 * 2 * 6
    baselines = {"black", "mean image", "albedo x constant", "direct light alone", "reflections too"}
    assert {r.predictor for r in records} == {MODEL, *baselines}


def test_values_are_those_of_the_known_images(records, data_root) -> None:
    sample = ShardSplit(data_root, "test")[0]  # 0.6 albedo, predicted as 0.5
    image = torch.from_numpy(sample.images[1])
    model = next(r for r in records if (r.scene, r.view, r.predictor) == (sample.key, 1, MODEL))
    black = next(r for r in records if (r.scene, r.view, r.predictor) == (sample.key, 1, "black"))
    expected = (log_encode(image) - log_encode(image * 5 / 6)).abs().mean().item()
    assert model.values["log_l1"] == pytest.approx(expected, rel=2e-3)
    assert black.values["l1"] == pytest.approx(image.mean().item(), rel=1e-5)


def test_the_constant_baseline_is_fitted_on_the_training_split(data_root) -> None:
    constant = fitted_baselines(ShardSplit(data_root, "train"), 10)[2]
    assert constant.constant == pytest.approx(0.5, rel=0.01)


def test_records_hold_the_size_of_their_scene(records, data_root) -> None:
    triangles = ShardSplit(data_root, "test")[2].triangles
    sizes = {(r.triangles, r.objects, r.lights) for r in records if r.scene == "test-000002"}
    assert sizes == {(len(triangles), triangles.num_objects, 2)}


def test_a_scenes_record_is_the_mean_of_its_views(records) -> None:
    views = [r.values["l1"] for r in records if r.scene == "test-000000" and r.predictor == "black"]
    (scene,) = [r for r in scene_records(records) if r.scene == "test-000000" and r.predictor == "black"]
    assert len(set(views)) == 2
    assert scene.values["l1"] == pytest.approx(sum(views) / 2)


def test_best_median_and_worst_scene(of_network) -> None:
    ranked = ranked_scenes(scene_records(of_network))
    assert list(ranked.values()) == [1, 0, 2]  # levels 0.5, 0.6, 0.9
    assert [caption.split(",")[0] for caption in ranked] == [
        "best: test-000001",
        "median: test-000000",
        "worst: test-000002",
    ]


def _scenes_with(*errors: float) -> list[SceneRecord]:
    return [SceneRecord("test", f"scene-{i}", 100, 5, 2, MODEL, {"log_l1": error}) for i, error in enumerate(errors)]


@pytest.mark.parametrize("total", [1, 2, 3, 4, 31, 32, 1000])
@pytest.mark.parametrize("count", [3, 4, 9])
def test_pictured_scenes_go_from_best_to_worst_by_way_of_the_median(total, count) -> None:
    scenes = _scenes_with(*np.random.default_rng(0).permutation(total).astype(float))
    shown = pictured_scenes(scenes, count)
    errors = [scenes[index].values["log_l1"] for index in shown]
    assert len(shown) == min(total, count - (count + 1) % 2)
    assert errors == sorted(errors)
    assert set(ranked_scenes(scenes).values()) <= set(shown)


def test_a_scene_that_is_not_a_number_is_the_worst() -> None:
    ranked = ranked_scenes(_scenes_with(0.2, float("nan"), 0.3))
    assert list(ranked.values()) == [0, 2, 1]


def test_progress_is_told_after_each_scene(data_root, half_albedo, cpu) -> None:
    calls = []
    split = ShardSplit(data_root, "test")
    network_records(half_albedo, split, ImageMetrics(lpips=None), cpu, lambda: calls.append("network"))
    baseline_records([], split, ImageMetrics(lpips=None), cpu, lambda: calls.append("baselines"))
    assert calls == ["network"] * len(split) + ["baselines"] * len(split)


def test_an_indivisible_resolution_is_one_line(data_root, half_albedo, cpu) -> None:
    half_albedo.patch_size = 5
    with pytest.raises(UserError, match="patch size 5") as error:
        render_stored(half_albedo, ShardSplit(data_root, "test"), 0, cpu)
    assert "\n" not in str(error.value)


def test_an_empty_split_is_named(data_root, half_albedo, cpu) -> None:
    class Empty(ShardSplit):
        def __len__(self) -> int:
            return 0

    with pytest.raises(ShardError, match="'test' is empty"):
        network_records(half_albedo, Empty(data_root, "test"), ImageMetrics(lpips=None), cpu, lambda: None)


def test_a_panel_of_chosen_scenes_is_written(data_root, half_albedo, cpu, tmp_path) -> None:
    split = ShardSplit(data_root, "test")
    scenes = {f"scene {i}": first_view(render_stored(half_albedo, split, i, cpu)) for i in range(2)}
    path = save_scene_panel(scenes, tmp_path / "new" / "test.png")
    assert path.read_bytes().startswith(b"\x89PNG")

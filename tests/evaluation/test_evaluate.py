import pytest
import torch

from rfpp.errors import ShardError, UserError
from rfpp.evaluation.evaluate import MODEL, evaluate_split, fitted_baselines, ranked_scenes, render_stored
from rfpp.evaluation.panels import save_scene_panel
from rfpp.evaluation.tables import scene_means, split_means
from rfpp.metrics.image import ImageMetrics
from rfpp.radiance import log_encode
from rfpp.shards.stream import ShardSplit


@pytest.fixture
def records(data_root, half_albedo, cpu):
    test, train = ShardSplit(data_root, "test"), ShardSplit(data_root, "train")
    return evaluate_split(half_albedo, test, fitted_baselines(train, 10), ImageMetrics(lpips=None), cpu)


def test_every_image_is_recorded_once_for_every_predictor(records) -> None:
    identities = [(r.scene, r.view, r.predictor) for r in records]
    assert len(identities) == len(set(identities)) == 3 * 2 * 5
    assert {r.predictor for r in records} == {MODEL, "black", "mean image", "albedo x constant", "direct light alone"}


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


def test_means_go_from_views_to_scenes_to_splits(records) -> None:
    scenes, splits = scene_means(records), split_means(records)
    views = [r.values["l1"] for r in records if r.scene == "test-000000" and r.predictor == "black"]
    assert scenes["test", "black", "test-000000"]["l1"] == pytest.approx(sum(views) / 2)
    of_scenes = [v["l1"] for (_, who, _), v in scenes.items() if who == "black"]
    assert splits["test", "black"]["l1"] == pytest.approx(sum(of_scenes) / 3)


def test_best_median_and_worst_scene(records) -> None:
    ranked = ranked_scenes(records)
    assert list(ranked.values()) == [1, 0, 2]  # levels 0.5, 0.6, 0.9
    assert [caption.split(",")[0] for caption in ranked] == [
        "best: test-000001",
        "median: test-000000",
        "worst: test-000002",
    ]


def test_progress_is_told_after_each_scene(data_root, half_albedo, cpu) -> None:
    calls = []
    split = ShardSplit(data_root, "test")
    evaluate_split(half_albedo, split, [], ImageMetrics(lpips=None), cpu, lambda: calls.append(1))
    assert len(calls) == len(split)


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
        evaluate_split(half_albedo, Empty(data_root, "test"), [], ImageMetrics(lpips=None), cpu)


def test_a_panel_of_chosen_scenes_is_written(data_root, half_albedo, cpu, tmp_path) -> None:
    split = ShardSplit(data_root, "test")
    scenes = {f"scene {i}": render_stored(half_albedo, split, i, cpu) for i in range(2)}
    path = save_scene_panel(scenes, tmp_path / "new" / "test.png")
    assert path.read_bytes().startswith(b"\x89PNG")

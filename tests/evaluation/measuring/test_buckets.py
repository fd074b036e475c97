import pytest

from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import bucketed
from rfpp.evaluation.measuring.records import SceneRecord


def test_the_models_scenes_fall_by_their_size_and_split(scenes, bootstrap) -> None:
    found = [
        (b.split, b.label, b.estimates["log_l1"].mean) for b in bucketed(scenes, {"triangles": [1000, 3000]}, bootstrap)
    ]
    assert found == [
        ("test", "0–999", pytest.approx(0.2)),
        ("test", "1000–2999", pytest.approx(0.4)),
        ("train_newviews", "0–999", pytest.approx(0.05)),
    ]


def test_an_edge_belongs_to_the_range_that_it_begins(bootstrap) -> None:
    scenes = [SceneRecord("test", str(n), n, 7, 2, "model", {"log_l1": float(n)}) for n in (999, 1000, 1001)]
    found = {b.label: b.estimates["log_l1"] for b in bucketed(scenes, {"triangles": [1000]}, bootstrap)}
    assert found["0–999"].scenes == 1
    assert found["≥ 1000"].mean == pytest.approx(1000.5)


def test_empty_buckets_are_left_out_and_every_scene_is_in_one_of_each_kind(scenes, bootstrap) -> None:
    buckets = bucketed(scenes, {"triangles": [10, 1000, 3000], "objects": [5, 10]}, bootstrap)
    for counted in ("triangles", "objects"):
        assert sum(b.estimates["psnr"].scenes for b in buckets if b.counted == counted and b.split == "test") == 2
    assert [b.label for b in buckets if b.counted == "objects"] == ["5–9"] * 2


@pytest.mark.parametrize("edges", [[0, 10], [10, 10], [30, 10]])
def test_edges_that_do_not_increase_are_named(scenes, bootstrap, edges) -> None:
    with pytest.raises(UserError, match=r"evaluation\.buckets\.objects"):
        bucketed(scenes, {"objects": edges}, bootstrap)

import csv

import pytest

from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import bucketed
from rfpp.evaluation.measuring.confidence import split_estimates
from rfpp.evaluation.measuring.csv_files import write_buckets, write_records, write_summary


def _rows(path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.open()))


def test_records_of_images_and_scenes(images, scenes, tmp_path) -> None:
    files = write_records(images, scenes, tmp_path / "evaluation")
    assert [f.name for f in files] == [
        "test.csv", "test_scenes.csv", "train_newviews.csv", "train_newviews_scenes.csv",
    ]  # fmt: skip
    of_images, of_scenes = _rows(files[0]), _rows(files[1])
    assert len(of_images) == 6
    assert of_images[1] == {"scene": "a", "view": "1", "predictor": "model", "log_l1": "0.3", "psnr": "20"}
    assert of_scenes[1] == {
        "scene": "b", "triangles": "2000", "objects": "7", "lights": "2", "predictor": "model",
        "log_l1": "0.4", "psnr": "10",
    }  # fmt: skip


def test_the_summary_has_means_intervals_and_the_number_of_scenes(scenes, bootstrap, tmp_path) -> None:
    path = write_summary(split_estimates(scenes, bootstrap), tmp_path)
    rows = {(row["split"], row["predictor"]): row for row in _rows(path)}
    assert list(rows["test", "black"]) == [
        "split", "predictor", "scenes",
        "log_l1", "log_l1_low", "log_l1_high", "psnr", "psnr_low", "psnr_high",
    ]  # fmt: skip
    test = rows["test", "model"]
    assert (test["scenes"], test["log_l1"], test["log_l1_low"], test["log_l1_high"]) == ("2", "0.3", "0.2", "0.4")
    assert rows["train_newviews", "model"]["log_l1_low"] == "nan"


def test_buckets_name_their_range(scenes, bootstrap, tmp_path) -> None:
    buckets = bucketed(scenes, {"triangles": [1000]}, bootstrap)
    first, second = _rows(write_buckets(buckets, tmp_path))[:2]
    assert (first["split"], first["counted"], first["from"], first["below"]) == ("test", "triangles", "0", "1000")
    assert (second["from"], second["below"], second["scenes"], second["log_l1"]) == ("1000", "", "1", "0.4")


def test_an_unwritable_folder_is_named(images, scenes, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"test\.csv"):
        write_records(images, scenes, tmp_path / "file")

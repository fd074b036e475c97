import csv

import pytest

from rfpp.evaluation.measuring.confidence import split_estimates
from rfpp.evaluation.measuring.csv_files import write_records, write_rows


@pytest.fixture
def rows(records, bootstrap, tmp_path) -> dict[str, list[dict[str, str]]]:
    files = write_records(records, split_estimates(records, bootstrap), tmp_path / "evaluation")
    return {file.name: list(csv.DictReader(file.open())) for file in files}


def test_one_row_per_image_and_one_per_scene(rows) -> None:
    assert len(rows["images.csv"]) == 7
    assert rows["images.csv"][1] == {
        "split": "test", "scene": "a", "view": "1", "predictor": "model", "log_l1": "0.3", "psnr": "20",
    }  # fmt: skip
    assert len(rows["scenes.csv"]) == 5
    assert rows["scenes.csv"][1] == {
        "split": "test", "scene": "b", "triangles": "2000", "objects": "7", "lights": "2", "predictor": "model",
        "log_l1": "0.4", "psnr": "10",
    }  # fmt: skip
    assert float(rows["scenes.csv"][0]["log_l1"]) == pytest.approx(0.2)


def test_the_summary_has_means_intervals_and_the_number_of_scenes(rows) -> None:
    by_predictor = {(row["split"], row["predictor"]): row for row in rows["summary.csv"]}
    assert list(by_predictor["test", "black"]) == [
        "split", "predictor", "scenes",
        "log_l1", "log_l1_low", "log_l1_high", "psnr", "psnr_low", "psnr_high",
    ]  # fmt: skip
    test = by_predictor["test", "model"]
    assert (test["scenes"], test["log_l1"], test["log_l1_low"], test["log_l1_high"]) == ("2", "0.3", "0.2", "0.4")
    assert by_predictor["train_newviews", "model"]["log_l1_low"] == "nan"


def test_a_missing_key_is_an_empty_cell(tmp_path) -> None:
    assert write_rows(tmp_path / "rows.csv", [{"a": 1}, {"b": 0.12345678}]).read_text() == "a,b\n1,\n,0.1234568\n"

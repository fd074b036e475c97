import csv
import io
import math
import re

import pytest
from rich.console import Console

from rfpp.errors import UserError
from rfpp.evaluation.tables import ImageRecord, results_table, split_means, write_csv


def _record(split: str, scene: str, view: int, predictor: str, log_l1: float, psnr: float) -> ImageRecord:
    return ImageRecord(split, scene, view, predictor, {"log_l1": log_l1, "psnr": psnr})


RECORDS = [
    _record("test", "a", 0, "model", 0.1, 30.0),
    _record("test", "a", 1, "model", 0.3, 20.0),
    _record("test", "b", 0, "model", 0.4, 10.0),
    _record("test", "a", 0, "black", 0.5, 35.0),
    _record("test", "a", 1, "black", 0.5, 35.0),
    _record("test", "b", 0, "black", 0.7, 35.0),
    _record("train_newviews", "c", 0, "model", 0.05, 33.0),
]


def _bold_numbers(line: str) -> list[str]:
    return re.findall(r"\x1b\[1;32m *([\d.]+)", line)


def _printed(means) -> str:
    stream = io.StringIO()
    Console(file=stream, width=160, force_terminal=True, color_system="standard").print(results_table(means))
    return stream.getvalue()


def test_every_scene_counts_the_same_however_many_views_it_has() -> None:
    assert split_means(RECORDS)["test", "model"]["log_l1"] == pytest.approx((0.2 + 0.4) / 2)


def test_csv_files_hold_every_record_and_mean(tmp_path) -> None:
    files = write_csv(RECORDS, tmp_path / "evaluation")
    assert [f.name for f in files] == [
        "test.csv", "test_scenes.csv", "train_newviews.csv", "train_newviews_scenes.csv", "summary.csv",
    ]  # fmt: skip
    images = list(csv.DictReader(files[0].open()))
    assert len(images) == 6
    assert images[1] == {"scene": "a", "view": "1", "predictor": "model", "log_l1": "0.3", "psnr": "20"}
    summary = {(row["split"], row["predictor"]): row for row in csv.DictReader(files[-1].open())}
    assert float(summary["test", "black"]["log_l1"]) == pytest.approx((0.5 + 0.7) / 2)


def test_best_is_bold_in_the_direction_of_each_metric() -> None:
    lines = [line for line in _printed(split_means(RECORDS)).splitlines() if "model" in line or "black" in line]
    model, black = lines[0], lines[1]
    assert _bold_numbers(model) == ["0.3000"]
    assert _bold_numbers(black) == ["35.00"]


def test_definitions_with_tone_map_and_epsilon_stand_beneath() -> None:
    printed = _printed({("test", "model"): {"mape": 0.5, "ssim": 0.9}})
    assert "0.01" in printed
    assert "log2(1 + I)" in printed


def test_nan_is_shown_and_never_best() -> None:
    means = {("test", "model"): {"l1": math.nan}, ("test", "black"): {"l1": 0.2}}
    printed = _printed(means)
    assert "nan" in printed
    assert _bold_numbers(printed) == ["0.2000"]


def test_an_unwritable_folder_is_named(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"test\.csv"):
        write_csv(RECORDS, tmp_path / "file")

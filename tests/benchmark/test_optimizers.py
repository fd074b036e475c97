"""Optimizers are compared from the same start on the same batches, and what is measured is not measured again."""

import csv
from itertools import pairwise

import pytest
from hydra import compose, initialize_config_dir
from networks import SMALLEST
from small_data import make

from launch.benchmark import main
from rfpp.commands import CONFIG_DIR


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "small", splits={"train": 4, "test": 2}).root


def run(data, output, *overrides, steps=3):
    training = [
        "experiment=quickstart", *SMALLEST, "size.width=54", f"data.root={data}", f"steps={steps}",
        "datamodule.scenes_per_step=2", "datamodule.views_per_scene=1", "schedule.warmup_steps=1",
    ]  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("benchmark", overrides=["benchmark=optimizers", f"output={output}", *overrides])
    cfg.benchmark.runs = {"adamw": training, "muon": [*training, "optimizer=muon"]}
    cfg.benchmark.setting.device, cfg.benchmark.setting.precision = "cpu", "32-true"
    cfg.benchmark.setting.threads, cfg.benchmark.every = 1, 2
    return main.__wrapped__(cfg)


def test_rows_of_every_run_from_the_same_start(data, tmp_path):
    output = tmp_path / "optimizers.csv"
    run(data, output, "benchmark.seeds=[0,1]")
    rows = list(csv.DictReader(output.open()))
    assert [(r["optimizer"], r["seed"], r["step"]) for r in rows] == [
        (name, seed, step) for seed in "01" for name in ("adamw", "muon") for step in "23"
    ]
    assert all(float(r["log_l1"]) > 0 and int(r["scenes"]) == 2 and int(r["training_scenes"]) == 4 for r in rows)
    for first, second in pairwise(rows):
        assert first["optimizer"] != second["optimizer"] or float(first["seconds"]) < float(second["seconds"])
    again = run(data, output, "benchmark.seeds=[0,1]", "benchmark.minutes=0")
    assert [r["log_l1"] for r in again] == [r["log_l1"] for r in rows]
    output.write_text("".join(output.read_text().splitlines(keepends=True)[:-1]))  # interrupted in the last run
    without = run(data, output, "benchmark.seeds=[0,1]", "benchmark.minutes=0")
    assert [r["log_l1"] for r in without] == [r["log_l1"] for r in rows[:-2]], "an unfinished run is made anew"


def test_a_run_gives_the_same_errors_again(data, tmp_path):
    made = [run(data, tmp_path / f"{i}.csv", "benchmark.seeds=[3]") for i in range(2)]
    assert [r["log_l1"] for r in made[0]] == [r["log_l1"] for r in made[1]]
    assert made[0][0]["log_l1"] != made[0][2]["log_l1"], "optimizers differ"

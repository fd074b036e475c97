"""A run without MLflow: its metrics are a table in its folder, even if its process is killed."""

import csv

from lightning.pytorch.loggers import CSVLogger

from rfpp.training.tracking.run_logger import RunLogger


def table(folder):
    with open(folder / "metrics.csv") as file:
        return [{name: value for name, value in row.items() if value} for row in csv.DictReader(file)]


def test_a_row_per_step_and_a_column_per_metric(tmp_path):
    logger = RunLogger("run", tmp_path)
    logger.log_metrics({"train/loss": 0.1, "epoch": 0}, 0)
    logger.log_metrics({"train/loss": 1e-9}, 1)
    logger.log_metrics({"validation/l1": 0.25}, 1)
    logger.finalize("success")
    assert table(tmp_path) == [
        {"step": "0", "train/loss": "0.1"},
        {"step": "1", "train/loss": "1e-09", "validation/l1": "0.25"},
    ]


def test_a_resumed_run_repeats_no_step_and_loses_none(tmp_path):
    killed = RunLogger("run", tmp_path)
    for step in range(4):
        killed.log_metrics({"loss": step / 2}, step)  # the last two after the last checkpoint
    again = RunLogger("run", tmp_path)
    for step in range(2, 6):
        again.log_metrics({"loss": step / 2}, step)
    again.finalize("success")
    assert [float(row["loss"]) for row in table(tmp_path)] == [step / 2 for step in range(6)]


def test_a_run_that_fails_before_it_logs_leaves_nothing(tmp_path):
    RunLogger("run", tmp_path / "run").finalize("failed")
    assert not (tmp_path / "run").exists()


def test_another_logger_gets_the_same_metrics(tmp_path):
    logger = RunLogger("run", tmp_path / "run", also=CSVLogger(tmp_path, "other", ""))
    for step in range(3):
        logger.log_metrics({"loss": step / 2}, step)
    logger.finalize("success")
    rows = [{"step": row["step"], "loss": row["loss"]} for row in table(tmp_path / "other")]
    assert rows == table(tmp_path / "run")

from pathlib import Path

import pytest
from mlflow.tracking import MlflowClient
from networks import checkpoint_info

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.evaluation.measuring.confidence import Estimate
from rfpp.evaluation.tracked_results import RUNS, log_to_training_run, results_folder, tracked_metrics

MEANS = {
    ("test", "model"): {"log_l1": Estimate(0.01, 0.008, 0.012, 5)},
    ("test", "albedo x constant"): {"log_l1": Estimate(0.03, 0.02, 0.04, 5)},
}


def _info(uri: str | None, run_id: str | None) -> CheckpointInfo:
    return checkpoint_info(mlflow_run_id=run_id, mlflow_tracking_uri=uri)


METRICS = {
    "test/log_l1": 0.01,
    "test_baselines/albedo_x_constant/log_l1": 0.03,
    "test/ablation/other_tokens": 0.5,
}


@pytest.fixture
def measured(evaluation):
    """`measured(data)`: an evaluation on that data set."""
    return lambda data: evaluation(data=data, means=MEANS, ablation={"test": {"other_tokens": 0.5}})


def test_names_separate_model_baselines_and_ablations(measured) -> None:
    assert tracked_metrics(measured("small")) == METRICS


@pytest.fixture
def finished_run(tmp_path) -> tuple[MlflowClient, str, str]:
    """Client, tracking URI and id of a finished training run."""
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    client = MlflowClient(uri)
    experiment = client.create_experiment("e", artifact_location=(tmp_path / "artifacts").as_uri())
    run = client.create_run(experiment).info.run_id
    client.set_terminated(run)
    return client, uri, run


@pytest.fixture
def table(tmp_path) -> Path:
    path = tmp_path / "summary.csv"
    path.write_text("split\n")
    return path


def test_results_are_added_to_the_finished_training_run(finished_run, table, measured) -> None:
    client, uri, run = finished_run
    assert log_to_training_run(_info(uri, run), measured("small"), [table]).startswith("Logged")
    assert client.get_run(run).data.metrics == METRICS
    assert [f.path for f in client.list_artifacts(run, "evaluation")] == ["evaluation/summary.csv"]


def test_an_unreachable_run_is_one_line(tmp_path, measured) -> None:
    line = log_to_training_run(_info(f"sqlite:///{tmp_path}/mlflow.db", "0" * 32), measured("small"), [])
    assert line.startswith("Not logged")
    assert "\n" not in line


def test_results_are_in_the_run_of_the_checkpoint(tmp_path) -> None:
    checkpoint = tmp_path / "run" / "checkpoints" / "best.ckpt"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"")
    assert results_folder(str(checkpoint), checkpoint_info(), "small") == tmp_path / "run" / "evaluation"
    assert results_folder(str(checkpoint), checkpoint_info(), "other") == tmp_path / "run" / "evaluation_other"


def test_a_model_folder_gets_a_folder_among_the_runs() -> None:
    folder = results_folder("someone/renderformer", checkpoint_info(), "other")
    assert folder == RUNS / "renderformer" / "evaluation_other"

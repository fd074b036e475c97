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


def test_names_tell_the_network_from_the_baselines() -> None:
    assert tracked_metrics(MEANS) == {"test/log_l1": 0.01, "test_baselines/albedo_x_constant/log_l1": 0.03}


@pytest.fixture
def finished_run(tmp_path) -> tuple[MlflowClient, str, str]:
    """Client, tracking URI and id of a training run that has ended."""
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


def test_results_are_added_to_the_finished_training_run(finished_run, table, evaluation) -> None:
    client, uri, run = finished_run
    mine = evaluation(data="small", means=MEANS, life={"test": {"exchanged_tokens": 0.5}})
    assert log_to_training_run(_info(uri, run), mine, [table]).startswith("Logged")
    assert client.get_run(run).data.metrics == tracked_metrics(MEANS) | {"test/life/exchanged_tokens": 0.5}
    assert [f.path for f in client.list_artifacts(run, "evaluation")] == ["evaluation/summary.csv"]


def test_results_on_other_data_do_not_replace_those_on_its_own(finished_run, table, evaluation) -> None:
    client, uri, run = finished_run
    log_to_training_run(_info(uri, run), evaluation(data="large_scale", means=MEANS), [table])
    assert client.get_run(run).data.metrics["large_scale/test/log_l1"] == 0.01
    assert "test/log_l1" not in client.get_run(run).data.metrics
    assert [f.path for f in client.list_artifacts(run)] == ["evaluation_large_scale"]


def test_a_lost_run_is_said_in_one_line(tmp_path, evaluation) -> None:
    line = log_to_training_run(
        _info(f"sqlite:///{tmp_path}/mlflow.db", "0" * 32), evaluation(data="small", means=MEANS), []
    )
    assert line.startswith("Not logged")
    assert "\n" not in line


def test_a_checkpoint_without_a_run_is_said(evaluation) -> None:
    assert "no MLflow run" in log_to_training_run(_info(None, None), evaluation(data="small", means=MEANS), [])


def test_results_go_into_the_run_of_the_checkpoint(tmp_path) -> None:
    checkpoint = tmp_path / "run" / "checkpoints" / "best.ckpt"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(b"")
    assert results_folder(str(checkpoint), checkpoint_info(), "small") == tmp_path / "run" / "evaluation"
    assert results_folder(str(checkpoint), checkpoint_info(), "other") == tmp_path / "run" / "evaluation_other"


def test_a_released_network_gets_a_folder_among_the_runs() -> None:
    folder = results_folder("someone/renderformer", checkpoint_info(), "other")
    assert folder == RUNS / "renderformer" / "evaluation_other"

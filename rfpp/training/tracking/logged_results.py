"""Log results to a finished run."""

from __future__ import annotations

from pathlib import Path

from rfpp.errors import UserError


def log_results(tracking_uri: str, run_id: str, metrics: dict[str, float], files: dict[Path, str]) -> None:
    """Add metrics, and files by artifact folder, to a run that has ended.

    Raises:
        UserError: MLflow does not know the run, or cannot be reached.
        ModuleNotFoundError: MLflow is not installed.
    """
    from mlflow.exceptions import MlflowException  # late: an evaluation does without, if it must

    from rfpp.training.tracking.mlflow_run import connected

    try:
        client = connected(tracking_uri)
        for name, value in metrics.items():
            client.log_metric(run_id, name, value)
        for file, folder in files.items():
            client.log_artifact(run_id, str(file), folder)
    except (MlflowException, OSError) as error:
        raise UserError((str(error).splitlines() or [type(error).__name__])[0][:200]) from error

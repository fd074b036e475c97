"""MLflow: one run per training, with everything needed to know later what it was."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import MLFlowLogger
from mlflow.tracking import MlflowClient

#: MLflow refuses longer parameter values.
MAX_PARAMETER_LENGTH = 500


def local_store(folder: str | Path) -> dict[str, str]:
    """Tracking URI and artifact location of an MLflow store in a folder: SQLite and files, no server needed."""
    folder = Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    return {"tracking_uri": f"sqlite:///{folder / 'mlflow.db'}", "artifact_location": (folder / "artifacts").as_uri()}


def mlflow_logger(
    experiment_name: str, run_name: str, folder: str | Path, tracking_uri: str | None = None
) -> MLFlowLogger:
    """A logger to the tracking server at `tracking_uri`, or to a store in `folder` when it is None."""
    where = {"tracking_uri": tracking_uri} if tracking_uri else local_store(folder)
    return MLFlowLogger(experiment_name=experiment_name, run_name=run_name, **where)


def describe_run(logger: MLFlowLogger, config: dict[str, Any], config_file: Path, tags: dict[str, str]) -> None:
    """Record the resolved config (flattened as parameters, and as a file) and tags such as code and data version."""
    parameters = {k: str(v)[:MAX_PARAMETER_LENGTH] for k, v in flattened(config).items()}
    logger.log_hyperparams(parameters)
    for key, value in tags.items():
        logger.experiment.set_tag(logger.run_id, key, value)
    logger.experiment.log_artifact(logger.run_id, str(config_file), "config")


def log_results(tracking_uri: str, run_id: str, metrics: dict[str, float], files: dict[Path, str]) -> None:
    """Add metrics, and files by artifact folder, to a run that has ended."""
    client = MlflowClient(tracking_uri)
    for name, value in metrics.items():
        client.log_metric(run_id, name, value)
    for file, folder in files.items():
        client.log_artifact(run_id, str(file), folder)


def flattened(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """{"a": {"b": 1}} → {"a.b": 1}."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def code_version() -> str | None:
    """The commit of this checkout, with `-dirty` when files differ from it; None outside a repository."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return described.stdout.strip()

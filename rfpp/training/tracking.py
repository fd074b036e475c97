"""MLflow: one run per training, with everything needed to know later what it was."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import MLFlowLogger
from lightning.pytorch.utilities import rank_zero_only
from mlflow.tracking import MlflowClient
from mlflow.utils.mlflow_tags import MLFLOW_PARENT_RUN_ID

#: MLflow refuses longer parameter values.
MAX_PARAMETER_LENGTH = 500


def local_store(folder: str | Path) -> dict[str, str]:
    """Tracking URI and artifact location of an MLflow store in a folder: SQLite and files, no server needed."""
    folder = Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    return {"tracking_uri": f"sqlite:///{folder / 'mlflow.db'}", "artifact_location": (folder / "artifacts").as_uri()}


def mlflow_logger(
    experiment_name: str,
    run_name: str,
    folder: str | Path,
    tracking_uri: str | None = None,
    parent: str | None = None,
) -> MLFlowLogger:
    """A logger to the tracking server at `tracking_uri`, or to a store in `folder` when it is None.

    Args:
        parent: name of the run that this one is part of; the first that names it makes it.
    """
    where = {"tracking_uri": tracking_uri} if tracking_uri else local_store(folder)
    logger = MLFlowLogger(experiment_name=experiment_name, run_name=run_name, **where)
    if parent is not None and rank_zero_only.rank == 0:
        client = logger.experiment
        client.set_tag(logger.run_id, MLFLOW_PARENT_RUN_ID, _parent_run(client, logger.experiment_id, parent))
    return logger


def _parent_run(client: MlflowClient, experiment: str, name: str) -> str:
    """The id of the run of this name that holds others."""
    holds_others = f"tags.holds_runs = 'true' and attributes.run_name = '{name}'"
    if found := client.search_runs([experiment], holds_others, max_results=1):
        return found[0].info.run_id
    return client.create_run(experiment, run_name=name, tags={"holds_runs": "true"}).info.run_id


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

"""Models and finished runs in MLflow, for commands that work without MLflow as long as they do not need them."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from rfpp.errors import CheckpointError, UserError

#: Artifact folder of a run's registered model, and its file.
FOLDER, CHECKPOINT = "model", "checkpoint.ckpt"


def checkpoint_file(checkpoint: str | None, tracking_uri: str | None, folder: Path) -> str:
    """Resolve `models:/<name>/<version>` or `models:/<name>/latest` to a file. Other strings are returned unchanged.

    Args:
        folder: Folder to download to, as `registered/<name>/<version>/checkpoints`.

    Raises:
        CheckpointError: If there is no such model, or it cannot be downloaded; if nothing is named.
    """
    if not checkpoint:
        raise CheckpointError(
            "checkpoint: nothing is named: give a file of launch/train.py, a model folder or radiosity"
        )
    if not checkpoint.startswith("models:/"):
        return checkpoint
    if not (parts := re.fullmatch(r"models:/([^/@]+)/(\d+|latest)", checkpoint)):
        raise CheckpointError(f"{checkpoint}: write models:/<name>/<version> or models:/<name>/latest")
    from mlflow.exceptions import MlflowException

    from rfpp.training.tracking.mlflow_run import store_uri

    store = tracking_uri or store_uri(folder)
    try:
        return str(_download(store, *parts.groups(), folder / "registered"))
    except (MlflowException, OSError) as error:
        raise CheckpointError(f"{checkpoint}: cannot be fetched from {store} ({first_line(error)})") from None


def log_results(tracking_uri: str, run_id: str, metrics: dict[str, float], files: dict[Path, str]) -> None:
    """Log metrics and files to a finished run.

    Raises:
        UserError: If MLflow does not have the run, or cannot be reached.
    """
    from mlflow.exceptions import MlflowException

    from rfpp.training.tracking.mlflow_run import connect

    try:
        client = connect(tracking_uri)
        for name, value in metrics.items():
            client.log_metric(run_id, name, value)
        for file, folder in files.items():
            client.log_artifact(run_id, str(file), folder)
    except (MlflowException, OSError) as error:
        raise UserError(first_line(error)) from error


def _download(store: str, name: str, version: str, folder: Path) -> Path:
    """Download a version's checkpoint, completely or not at all, unless `folder` holds it; return its path."""
    import mlflow
    from mlflow.exceptions import MlflowException

    from rfpp.training.tracking.mlflow_run import connect

    client = connect(store)
    if version != "latest":
        found = client.get_model_version(name, version)
    elif versions := client.search_model_versions(f"name = '{name}'"):
        found = max(versions, key=lambda candidate: int(candidate.version))
    else:
        raise MlflowException(f"no version of a model {name}")
    target = folder / found.name / str(found.version) / "checkpoints" / CHECKPOINT
    if not target.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=target.parent) as temporary:
            source = f"{found.source}/{CHECKPOINT}"
            path = mlflow.artifacts.download_artifacts(artifact_uri=source, tracking_uri=store, dst_path=temporary)
            Path(path).replace(target)
    return target


def first_line(error: Exception) -> str:
    """Return the first line of an error message, shortened."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]

"""Results where they belong: in the training run that made the checkpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mlflow.exceptions import MlflowException

from rfpp.evaluation.evaluate import MODEL
from rfpp.inference.checkpoint import CheckpointInfo
from rfpp.training.tracking import log_results


def tracked_metrics(means: Mapping[tuple[str, str], Mapping[str, float]]) -> dict[str, float]:
    """MLflow names: `test/log_l1` for the network, `test_baselines/mean_image/log_l1` for the others."""
    return {
        f"{_group(split, predictor)}/{name}": value
        for (split, predictor), values in means.items()
        for name, value in values.items()
    }


def log_to_training_run(
    info: CheckpointInfo, means: Mapping[tuple[str, str], Mapping[str, float]], files: Sequence[Path]
) -> str:
    """Add means and files (under `evaluation/`) to the run that made the checkpoint; returns a line about it.

    A run that cannot be reached (a checkpoint copied to another machine) is said, not raised: the results are in
    the files already.
    """
    if info.mlflow_run_id is None or info.mlflow_tracking_uri is None:
        return "The checkpoint names no MLflow run: nothing logged there."
    run = f"MLflow run {info.mlflow_run_id} in {info.mlflow_tracking_uri}"
    where = dict.fromkeys(files, "evaluation")
    try:
        log_results(info.mlflow_tracking_uri, info.mlflow_run_id, tracked_metrics(means), where)
    except (MlflowException, OSError) as error:
        return f"Not logged to {run}: {str(error).splitlines()[0][:200]}"
    return f"Logged to {run}"


def _group(split: str, predictor: str) -> str:
    return split if predictor == MODEL else f"{split}_baselines/{predictor.replace(' ', '_')}"

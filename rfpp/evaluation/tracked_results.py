"""Log results to the training run of the checkpoint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.errors import UserError
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.records import MODEL
from rfpp.extras import missing_extra
from rfpp.training.tracking import log_results

#: Default folder of training runs.
RUNS = Path("data/runs")


def tracked_metrics(evaluation: Evaluation, prefix: str = "") -> dict[str, float]:
    """Return results by MLflow name.

    Names are `test/log_l1` for the model, `test_baselines/mean_image/log_l1` for baselines and
    `test/ablation/no_operator` for ablations.
    """
    metrics = {}
    for (split, predictor), values in evaluation.means.items():
        group = split if predictor == MODEL else f"{split}_baselines/{predictor.replace(' ', '_')}"
        metrics |= {f"{prefix}{group}/{name}": estimate.mean for name, estimate in values.items()}
    for split, growth in evaluation.ablation.items():
        metrics |= {f"{prefix}{split}/ablation/{name}": value for name, value in growth.items()}
    return metrics


def results_folder(checkpoint: str, info: CheckpointInfo, data: str) -> Path:
    """Return the default folder for results: `evaluation` in the run's folder, with a suffix for other data sets.

    A model folder, or a name on a hub, belongs to no run and gets a folder of its own in `RUNS`.
    """
    path = Path(checkpoint)
    run = path.absolute().parents[1] if path.is_file() else RUNS / path.name
    return run / _artifact_folder(info, data)


def log_to_training_run(info: CheckpointInfo, evaluation: Evaluation, files: Sequence[Path]) -> str:
    """Log metrics and files to the training run of the checkpoint; return a status line.

    For a data set other than the training's, names of metrics start with `<data>/`, and files are in
    `evaluation_<data>/`. An unreachable run is reported in the status line, because the results are already on disk.
    """
    if info.mlflow_run_id is None or info.mlflow_tracking_uri is None:
        return "The checkpoint names no MLflow run: nothing logged there."
    run = f"MLflow run {info.mlflow_run_id} in {info.mlflow_tracking_uri}"
    folders = dict.fromkeys(files, _artifact_folder(info, evaluation.data))
    metrics = tracked_metrics(evaluation, "" if evaluation.data == info.dataset else f"{evaluation.data}/")
    try:
        log_results(info.mlflow_tracking_uri, info.mlflow_run_id, metrics, folders)
    except (UserError, ModuleNotFoundError) as error:
        return f"Not logged to {run}: {missing_extra(error) or error}"
    return f"Logged to {run}"


def _artifact_folder(info: CheckpointInfo, data: str) -> str:
    return "evaluation" if data == info.dataset else f"evaluation_{data}"

"""Log results to the training run that made the checkpoint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Estimates
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.records import MODEL
from rfpp.extras import missing_extra
from rfpp.training.tracking import log_results

#: Where training puts its runs unless told otherwise.
RUNS = Path("data/runs")


def tracked_metrics(means: Mapping[tuple[str, str], Estimates], prefix: str = "") -> dict[str, float]:
    """MLflow names: `test/log_l1` for the network, `test_baselines/mean_image/log_l1` for the others."""
    return {
        f"{prefix}{_group(split, predictor)}/{name}": estimate.mean
        for (split, predictor), values in means.items()
        for name, estimate in values.items()
    }


def results_folder(checkpoint: str, info: CheckpointInfo, data: str) -> Path:
    """`evaluation` in the checkpoint's run folder, or `evaluation_<data>` for a data set it was not trained on."""
    return run_folder(checkpoint) / _artifact_folder(info, data)


def run_folder(checkpoint: str) -> Path:
    """The folder of the training run that wrote a checkpoint.

    A released network (a folder, or a name on a hub) is of no run here and gets a folder of its own among them.
    """
    path = Path(checkpoint)
    return path.absolute().parents[1] if path.is_file() else RUNS / path.name


def log_to_training_run(info: CheckpointInfo, evaluation: Evaluation, files: Sequence[Path]) -> str:
    """Log metrics and files to the training run of the checkpoint; returns a status line.

    On a data set that it was not trained on, metrics begin with `<data>/`, and files are in `evaluation_<data>/`.

    A run that cannot be reached (a checkpoint copied to another machine) is said, not raised: the results are in
    the files already.
    """
    if info.mlflow_run_id is None or info.mlflow_tracking_uri is None:
        return "The checkpoint names no MLflow run: nothing logged there."
    run = f"MLflow run {info.mlflow_run_id} in {info.mlflow_tracking_uri}"
    data = evaluation.data
    where = dict.fromkeys(files, _artifact_folder(info, data))
    prefix = "" if data == info.dataset else f"{data}/"
    metrics = tracked_metrics(evaluation.means, prefix)
    for split, shares in evaluation.life.items():
        metrics |= {f"{prefix}{split}/life/{what}": share for what, share in shares.items()}
    try:
        log_results(info.mlflow_tracking_uri, info.mlflow_run_id, metrics, where)
    except (UserError, ModuleNotFoundError) as error:
        return f"Not logged to {run}: {missing_extra(error) or error}"
    return f"Logged to {run}"


def _group(split: str, predictor: str) -> str:
    return split if predictor == MODEL else f"{split}_baselines/{predictor.replace(' ', '_')}"


def _artifact_folder(info: CheckpointInfo, data: str) -> str:
    return "evaluation" if data == info.dataset else f"evaluation_{data}"

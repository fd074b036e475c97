"""Log a run's data set to MLflow."""

from __future__ import annotations

import json

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag
from mlflow.utils.mlflow_tags import MLFLOW_DATASET_CONTEXT
from mlflow.utils.validation import MAX_DATASET_DIGEST_SIZE

from rfpp.training.tracking.journal import Record


def log_dataset(client: MlflowClient, run_id: str, record: Record) -> None:
    """Log a data set as the run's input; the digest is the manifest's hash, truncated to MLflow's limit."""
    kind, key = ("http", "url") if record["source"].startswith(("http://", "https://")) else ("local", "uri")
    dataset = Dataset(
        name=record["name"],
        digest=record["digest"][:MAX_DATASET_DIGEST_SIZE],
        source_type=kind,
        source=json.dumps({key: record["source"]}),
        profile=json.dumps(record["counts"]),
    )
    client.log_inputs(run_id, [DatasetInput(dataset, [InputTag(MLFLOW_DATASET_CONTEXT, "training")])])

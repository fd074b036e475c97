"""Trained networks in MLflow's model registry, and back from there to a checkpoint file."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import mlflow
import numpy as np
from mlflow import MlflowClient
from mlflow.entities.model_registry import ModelVersion
from mlflow.exceptions import MlflowException
from mlflow.models import Model, ModelSignature
from mlflow.types import ColSpec, DataType, Schema, TensorSpec

from rfpp.errors import CheckpointError
from rfpp.inference.checkpoint import CheckpointInfo, load_network
from rfpp.training.tracking.store import connected, store_uri

#: Artifact folder of a run's registered model, and the checkpoint's name in it.
FOLDER, CHECKPOINT = "model", "checkpoint.ckpt"


def register(client: MlflowClient, run_id: str, checkpoint: Path, name: str) -> ModelVersion:
    """Make a run's checkpoint the next version of the model `name`; a run that has a version keeps it.

    The MLflow model holds the checkpoint file and its signature, and no code: it is not for `mlflow.pyfunc`.
    """
    _, info = load_network(checkpoint)
    model = Model(artifact_path=FOLDER, run_id=run_id, signature=_signature(info))
    model.add_flavor("rfpp", checkpoint=CHECKPOINT, method=info.method, data_manifest=info.data_manifest)
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "MLmodel")
        (Path(folder) / CHECKPOINT).symlink_to(checkpoint.resolve())
        client.log_artifacts(run_id, folder, FOLDER)
    if not client.search_registered_models(f"name = '{name}'"):
        client.create_registered_model(name)
    versions = [v for v in client.search_model_versions(f"name = '{name}'") if v.run_id == run_id]
    return versions[0] if versions else client.create_model_version(name, f"runs:/{run_id}/{FOLDER}", run_id)


def checkpoint_file(checkpoint: str, tracking_uri: str | None, folder: Path) -> str:
    """The file of a registered model: `models:/<name>/<version>`, `models:/<name>/latest` or `models:/<name>@<alias>`.

    Args:
        checkpoint: anything else is returned as it is.
        tracking_uri: of the MLflow server, or None for the store in `folder`.
        folder: fetched to its `registered/<name>/<version>/checkpoints`, like the run folder of a training here.

    Raises:
        CheckpointError: there is no such model, or it cannot be fetched.
    """
    if not checkpoint.startswith("models:/"):
        return checkpoint
    if not (parts := re.fullmatch(r"models:/([^/@]+)(?:/(\d+|latest)|@([^/@]+))", checkpoint)):
        raise CheckpointError(
            f"{checkpoint}: write models:/<name>/<version>, models:/<name>/latest or models:/<name>@<alias>"
        )
    store = tracking_uri or store_uri(folder)
    try:
        version = _version(connected(store), *parts.groups())
        target = folder / "registered" / version.name / str(version.version) / "checkpoints" / CHECKPOINT
        if not target.is_file():
            _fetch(f"{version.source}/{CHECKPOINT}", store, target)
    except (MlflowException, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise CheckpointError(f"{checkpoint}: cannot be fetched from {store} ({reason})") from None
    return str(target)


def _version(client: MlflowClient, name: str, version: str | None, alias: str | None) -> ModelVersion:
    if alias is not None:
        return client.get_model_version_by_alias(name, alias)
    if version != "latest":
        return client.get_model_version(name, version)
    if not (versions := client.search_model_versions(f"name = '{name}'")):
        raise MlflowException(f"no version of a model {name}")
    return max(versions, key=lambda found: int(found.version))


def _fetch(uri: str, tracking_uri: str, target: Path) -> None:
    """Copy an artifact to `target`, whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as temporary:
        fetched = mlflow.artifacts.download_artifacts(artifact_uri=uri, tracking_uri=tracking_uri, dst_path=temporary)
        Path(fetched).replace(target)


def _signature(info: CheckpointInfo) -> ModelSignature:
    """A scene in RenderFormer's JSON → an image of linear radiance for each of its cameras."""
    height, width = info.resolution
    images = TensorSpec(np.dtype(np.float32), (-1, height, width, 3))
    return ModelSignature(inputs=Schema([ColSpec(DataType.string, "scene")]), outputs=Schema([images]))

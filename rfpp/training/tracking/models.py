"""Trained networks in MLflow's model registry."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mlflow
import numpy as np
from mlflow import MlflowClient
from mlflow.entities.model_registry import ModelVersion
from mlflow.exceptions import MlflowException
from mlflow.models import Model, ModelSignature
from mlflow.types import ColSpec, DataType, Schema, TensorSpec

from rfpp.checkpoint.loading import CheckpointInfo, load_network
from rfpp.errors import CheckpointError
from rfpp.training.tracking.mlflow_run import connected, store_uri

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


def fetched(name: str, version: str | None, alias: str | None, tracking_uri: str | None, folder: Path) -> Path:
    """The checkpoint file of a version, by its number, "latest" or an alias; copied into `folder` where it is not yet.

    Raises:
        CheckpointError: there is no such model, or it cannot be fetched.
    """
    store = tracking_uri or store_uri(folder)
    try:
        found = _version(connected(store), name, version, alias)
        target = folder / "registered" / found.name / str(found.version) / "checkpoints" / CHECKPOINT
        if not target.is_file():
            _fetch(f"{found.source}/{CHECKPOINT}", store, target)
    except (MlflowException, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        asked = f"@{alias}" if version is None else f"/{version}"
        raise CheckpointError(f"models:/{name}{asked}: cannot be fetched from {store} ({reason})") from None
    return target


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

"""Find or create a run in an MLflow store."""

from __future__ import annotations

import json
import logging
import os
import socket
import uuid
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Experiment
from mlflow.tracking.context.registry import resolve_tags
from mlflow.utils.mlflow_tags import MLFLOW_PARENT_RUN_ID, MLFLOW_RUN_NAME

from rfpp.errors import UserError
from rfpp.files import write_atomically

#: Whoever waits for a server does so here, where nothing else does; MLflow's own retries take minutes.
ONE_TRY = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0", "MLFLOW_HTTP_REQUEST_TIMEOUT": "30"}
#: Tells the runs of this project's run folders apart, even where a process died before it learned its run's id.
FOLDER_TAG = "run_folder_id"


def connected(tracking_uri: str) -> MlflowClient:
    """An MLflow client without retries or log noise, unless the environment configures retries."""
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    for name, value in ONE_TRY.items():
        os.environ.setdefault(name, value)
    return MlflowClient(tracking_uri)


def store_uri(folder: str | Path) -> str:
    """Tracking URI of the MLflow store in a folder: SQLite, no server needed."""
    return f"sqlite:///{Path(folder).resolve() / 'mlflow.db'}"


#: MLflow's pages begin with what is there for training, not for language models, where they go by this. Those of 3.17
#: go by `workflowType` in their address.
SHOWN_AS = {"mlflow.experimentKind": "custom_model_development"}


@dataclass(frozen=True)
class Target:
    """The MLflow run of a run folder, stored in a file in it.

    Attributes:
        folder_id: of the run folder; the tag FOLDER_TAG of its run.
        tracking_uri: of the server, or of a database.
        artifact_location: of the experiment's artifacts, where no server decides it.
        experiment_name, run_name: the latter need not be unique.
        parent: name of the run that this one is part of, or None.
        run_id: None until the run has been made.
        sent: bytes of the journal that MLflow has.
    """

    folder_id: str
    tracking_uri: str
    artifact_location: str | None
    experiment_name: str
    run_name: str
    parent: str | None
    run_id: str | None = None
    sent: int = 0

    @classmethod
    def new(
        cls, folder: str | Path, tracking_uri: str | None, experiment_name: str, run_name: str, parent: str | None
    ) -> Target:
        """For a run that MLflow does not have yet: on a server, or in the store in `folder` when there is none."""
        served = tracking_uri is not None and tracking_uri.startswith(("http://", "https://", "databricks"))
        if not served:  # MLflow would put artifacts into the current directory's ./mlruns
            Path(folder).mkdir(parents=True, exist_ok=True)
        return cls(
            folder_id=uuid.uuid4().hex,
            tracking_uri=tracking_uri or store_uri(folder),
            artifact_location=None if served else (Path(folder).resolve() / "artifacts").as_uri(),
            experiment_name=experiment_name,
            run_name=run_name,
            parent=parent,
        )

    @classmethod
    def load(cls, path: Path) -> Target:
        """Raises UserError when the file does not hold one."""
        try:
            return cls(**json.loads(path.read_bytes()))
        except (OSError, ValueError, TypeError) as error:
            raise UserError(
                f"{path}: does not say which MLflow run this folder's is ({error}): delete it to begin another run"
            ) from None

    def write(self, path: Path) -> None:
        write_atomically(path, json.dumps(asdict(self), indent=1).encode())

    def with_run(self, client: MlflowClient) -> Target:
        """With the id of the folder's run, which is made in MLflow where there is none."""
        if self.run_id is not None:
            return self
        experiment = _experiment(client, self.experiment_name, self.artifact_location).experiment_id
        if found := client.search_runs([experiment], f"tags.{FOLDER_TAG} = '{self.folder_id}'", max_results=1):
            return replace(self, run_id=found[0].info.run_id)
        tags = {FOLDER_TAG: self.folder_id, MLFLOW_RUN_NAME: self.run_name, "host": socket.gethostname()}
        if self.parent is not None:
            tags[MLFLOW_PARENT_RUN_ID] = _parent_run(client, experiment, self.parent)
        return replace(self, run_id=client.create_run(experiment, tags=resolve_tags(tags)).info.run_id)


def _experiment(client: MlflowClient, name: str, artifact_location: str | None) -> Experiment:
    found = client.get_experiment_by_name(name)
    return found or client.get_experiment(client.create_experiment(name, artifact_location, SHOWN_AS))


def _parent_run(client: MlflowClient, experiment: str, name: str) -> str:
    """The id of the parent run with this name, which is created if it does not exist."""
    holds_others = f"tags.holds_runs = 'true' and attributes.run_name = '{name}'"

    def oldest() -> str | None:
        found = client.search_runs([experiment], holds_others, max_results=1, order_by=["attributes.start_time"])
        return found[0].info.run_id if found else None

    if (parent := oldest()) is not None:
        return parent
    mine = client.create_run(experiment, run_name=name, tags={"holds_runs": "true"}).info.run_id
    if (parent := oldest()) != mine:  # another child of a sweep was as quick
        client.delete_run(mine)
    return parent

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

from rfpp.errors import UserError
from rfpp.files import write_atomically

#: The sender retries by itself; MLflow's own retries take minutes.
ONE_TRY = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0", "MLFLOW_HTTP_REQUEST_TIMEOUT": "30"}
#: Tag that identifies the MLflow run of a run folder, even if a process died before it received the run's id.
FOLDER_TAG = "run_folder_id"
#: Tag that identifies the parent run of a sweep.
SWEEP_TAG = "sweep"


def connect(tracking_uri: str) -> MlflowClient:
    """Return an MLflow client without log noise, and without retries unless the environment configures them."""
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    for name, value in ONE_TRY.items():
        os.environ.setdefault(name, value)
    return MlflowClient(tracking_uri)


def store_uri(folder: str | Path) -> str:
    """Return the tracking URI of the MLflow store in a folder: an SQLite database, which needs no server."""
    return f"sqlite:///{Path(folder).resolve() / 'mlflow.db'}"


@dataclass(frozen=True)
class MlflowRun:
    """MLflow run of a run folder, stored in a file of the folder.

    Attributes:
        folder_id: Id of the run folder, the value of FOLDER_TAG.
        artifact_location: Folder of the experiment's artifacts; None if the server decides.
        sent: Bytes of the journal that MLflow has received.
        sweep: Name of the sweep, whose runs are children of one run; None if there is no sweep.
    """

    folder_id: str
    tracking_uri: str
    artifact_location: str | None
    experiment_name: str
    run_name: str
    run_id: str | None = None
    sent: int = 0
    sweep: str | None = None

    @classmethod
    def new(
        cls, folder: str | Path, tracking_uri: str | None, experiment_name: str, run_name: str, sweep: str | None
    ) -> MlflowRun:
        """Describe a run that MLflow does not have yet: on a server, or in the store in `folder`."""
        on_server = tracking_uri is not None and tracking_uri.startswith(("http://", "https://", "databricks"))
        if not on_server:  # by default MLflow would write artifacts to the current directory
            Path(folder).mkdir(parents=True, exist_ok=True)
        return cls(
            folder_id=uuid.uuid4().hex,
            tracking_uri=tracking_uri or store_uri(folder),
            artifact_location=None if on_server else (Path(folder).resolve() / "artifacts").as_uri(),
            experiment_name=experiment_name,
            run_name=run_name,
            sweep=sweep,
        )

    @classmethod
    def load(cls, path: Path) -> MlflowRun:
        """Read the file of a run folder."""
        try:
            return cls(**json.loads(path.read_bytes()))
        except (OSError, ValueError, TypeError) as error:
            raise UserError(
                f"{path}: does not name this folder's MLflow run ({error}): delete it to begin another run"
            ) from None

    def write(self, path: Path) -> None:
        write_atomically(path, json.dumps(asdict(self), indent=1).encode())

    def created(self, client: MlflowClient) -> MlflowRun:
        """Return this run with its id, creating it in MLflow if missing."""
        if self.run_id is not None:
            return self
        if (known := client.get_experiment_by_name(self.experiment_name)) is not None:
            experiment = known.experiment_id
        else:
            experiment = client.create_experiment(self.experiment_name, self.artifact_location)
        if found := client.search_runs([experiment], f"tags.{FOLDER_TAG} = '{self.folder_id}'", max_results=1):
            return replace(self, run_id=found[0].info.run_id)
        tags = {FOLDER_TAG: self.folder_id, "host": socket.gethostname()}
        if self.sweep is not None:
            tags["mlflow.parentRunId"] = _parent(client, experiment, self.sweep)
        return replace(self, run_id=client.create_run(experiment, tags=tags, run_name=self.run_name).info.run_id)


def _parent(client: MlflowClient, experiment: str, sweep: str) -> str:
    """Return the id of a sweep's parent run; if several processes create one at the same time, that of the oldest."""
    query, oldest = f"tags.{SWEEP_TAG} = '{sweep}'", ["attributes.start_time", "attributes.run_id"]
    if not client.search_runs([experiment], query, max_results=1):
        created = client.create_run(experiment, tags={SWEEP_TAG: sweep}, run_name=f"sweep {sweep}")
        client.set_terminated(created.info.run_id)
    found: str = client.search_runs([experiment], query, order_by=oldest, max_results=1)[0].info.run_id
    return found

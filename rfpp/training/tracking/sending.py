"""Send the journal to MLflow in a background thread."""

from __future__ import annotations

import json
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.exceptions import MlflowException

from rfpp.training.tracking.journal import JOURNAL, RUN_FILE, Record, records
from rfpp.training.tracking.mlflow_run import MlflowRun, connect
from rfpp.training.tracking.registry import FOLDER, first_line

#: MLflow's errors that repeat however often a request is sent.
REFUSALS = ("INVALID_PARAMETER_VALUE", "BAD_REQUEST", "RESOURCE_DOES_NOT_EXIST", "INVALID_STATE")
#: MLflow's limits of a request, and of a data set's digest.
MAX_METRICS, MAX_PARAMETERS, MAX_DIGEST = 1000, 100, 36
SECONDS_BETWEEN_BATCHES = 2.0
MAX_SECONDS_BETWEEN_TRIES = 30.0


class Sender(threading.Thread):
    """Sender of a run folder's journal, from where the last one stopped until it is closed.

    Records sent by a process that died before it noted them are sent again. This changes nothing: MLflow ignores a
    repeated metric (key, value, step, time), and overwrites everything else with the same value.
    """

    def __init__(self, run_dir: Path):
        super().__init__(name="mlflow-sender", daemon=True)
        self.run_dir = run_dir
        self.mlflow_run = MlflowRun.load(run_dir / RUN_FILE)
        self.problem: str | None = None
        self.registered: str | None = None
        self._client: MlflowClient | None = None
        self._refused: set[str] = set()
        self._first_try, self._closing = threading.Event(), threading.Event()

    def run_id(self, patience: float) -> str | None:
        """Return the run's id, or None if MLflow has not answered within `patience` seconds."""
        if self.mlflow_run.run_id is None and not self._first_try.is_set():
            self._first_try.wait(patience)
            self._first_try.set()  # wait only once
        return self.mlflow_run.run_id

    def close(self, seconds: float) -> bool:
        """Send the rest for at most this many seconds; return True if all is sent."""
        self._closing.set()
        if self.is_alive():
            self.join(seconds)
        return not self.is_alive() and self.problem is None

    def run(self) -> None:
        pause = 1.0
        while True:
            closing = self._closing.is_set()  # read before sending, so that the last records are sent too
            try:
                self.send()
            except Exception as error:  # of any kind: tracking must never stop training
                self._report_outage(error)
                pause = min(2 * pause, MAX_SECONDS_BETWEEN_TRIES)
            else:
                self.problem, pause = None, 1.0
                if closing:
                    return
            self._first_try.set()
            if closing:
                time.sleep(1.0)
            else:
                self._closing.wait(pause if self.problem else SECONDS_BETWEEN_BATCHES)

    def send(self) -> None:
        """Send everything the journal holds now. Raises MLflow's exceptions if it cannot be reached."""
        if self._client is None:
            client = connect(self.mlflow_run.tracking_uri)
            self._update(self.mlflow_run.created(client))
            self._client = client
        for batch, end in _batches(self.run_dir / JOURNAL, self.mlflow_run.sent):
            try:
                self._deliver(batch)
            except (MlflowException, FileNotFoundError) as error:
                if isinstance(error, MlflowException) and error.error_code not in REFUSALS:
                    raise
                self._report_refusal(batch[0]["kind"], error)
            self._update(replace(self.mlflow_run, sent=end))

    def _deliver(self, batch: list[Record]) -> None:
        client, run, first = self._client, self.mlflow_run.run_id, batch[0]
        match first["kind"]:
            case "metrics":
                metrics = [Metric(k, v, r["time"], r["step"]) for r in batch for k, v in r["values"].items()]
                for start in range(0, len(metrics), MAX_METRICS):
                    client.log_batch(run, metrics=metrics[start : start + MAX_METRICS])
            case "parameters":
                parameters = [Param(k, v) for k, v in first["values"].items()]
                for start in range(0, len(parameters), MAX_PARAMETERS):
                    client.log_batch(run, params=parameters[start : start + MAX_PARAMETERS])
            case "tags":
                client.log_batch(run, tags=[RunTag(k, v) for k, v in first["values"].items()])
            case "dataset":
                context = InputTag("mlflow.data.context", "training")
                client.log_inputs(run, [DatasetInput(_dataset(first), [context])])
            case "artifact":
                client.log_artifact(run, str(self.run_dir / first["path"]), first["folder"])
            case "model":
                self.registered = _register(client, run, self.run_dir / first["path"], first["name"])
            case "status" if first["value"] == "RUNNING":
                client.update_run(run, "RUNNING")
            case "status":
                client.set_terminated(run, first["value"], first["time"])

    def _update(self, mlflow_run: MlflowRun) -> None:
        if mlflow_run != self.mlflow_run:
            mlflow_run.write(self.run_dir / RUN_FILE)
            self.mlflow_run = mlflow_run

    def _report_outage(self, error: Exception) -> None:
        """Warn once per outage of MLflow."""
        if self.problem is None:
            warnings.warn(
                f"MLflow at {self.mlflow_run.tracking_uri} cannot be reached ({first_line(error)}): training "
                f"continues, and its log is kept in {self.run_dir / 'tracking'} and sent later",
                stacklevel=1,
            )
        self.problem = first_line(error)

    def _report_refusal(self, kind: str, error: Exception) -> None:
        """Warn once per kind of refused record."""
        if kind not in self._refused:
            self._refused.add(kind)
            warnings.warn(f"MLflow refused {kind} ({first_line(error)}): not logged", stacklevel=1)


def _batches(path: Path, start: int) -> Iterator[tuple[list[Record], int]]:
    """Yield batches of records, each with the byte offset of the next.

    Metrics are batched up to MLflow's limit; other records come one by one.
    """
    batch, count, end = [], 0, start
    for record, following in records(path, start):
        is_metrics = record["kind"] == "metrics"
        if batch and (not is_metrics or count + len(record["values"]) > MAX_METRICS):
            yield batch, end
            batch, count = [], 0
        if is_metrics:
            batch.append(record)
            count += len(record["values"])
        else:
            yield [record], following
        end = following
    if batch:
        yield batch, end


def _dataset(record: Record) -> Dataset:
    """Describe a data set; its digest is the manifest's hash, shortened to MLflow's limit."""
    kind, key = ("http", "url") if record["source"].startswith(("http://", "https://")) else ("local", "uri")
    return Dataset(
        name=record["name"],
        digest=record["digest"][:MAX_DIGEST],
        source_type=kind,
        source=json.dumps({key: record["source"]}),
        profile=json.dumps(record["counts"]),
    )


def _register(client: MlflowClient, run_id: str, checkpoint: Path, name: str) -> str:
    """Register a run's checkpoint as the next version of a model, once per run; return `models:/<name>/<version>`."""
    client.log_artifact(run_id, str(checkpoint), FOLDER)
    if not client.search_registered_models(f"name = '{name}'"):
        client.create_registered_model(name)
    versions = [v for v in client.search_model_versions(f"name = '{name}'") if v.run_id == run_id]
    version = versions[0] if versions else client.create_model_version(name, f"runs:/{run_id}/{FOLDER}", run_id)
    return f"models:/{name}/{version.version}"

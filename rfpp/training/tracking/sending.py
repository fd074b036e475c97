"""Send the journal to MLflow in a background thread."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Metric, Param, RunTag
from mlflow.exceptions import MlflowException
from mlflow.utils.validation import MAX_METRICS_PER_BATCH, MAX_PARAMS_TAGS_PER_BATCH

from rfpp.errors import UserError
from rfpp.training.tracking.datasets import log_dataset
from rfpp.training.tracking.journal import JOURNAL, Record, records
from rfpp.training.tracking.mlflow_run import Target, connected
from rfpp.training.tracking.models import register

#: What says which MLflow run a run folder's is, beside its journal.
TARGET = "run.json"
#: Answers that will not change when the same is asked again.
REFUSALS = ("INVALID_PARAMETER_VALUE", "BAD_REQUEST", "RESOURCE_DOES_NOT_EXIST", "INVALID_STATE")
SECONDS_BETWEEN_BATCHES = 2.0
MAX_SECONDS_BETWEEN_TRIES = 30.0


class Sender(threading.Thread):
    """Sends a run folder's journal, continuing where the last sender stopped, until it is closed.

    Whatever was sent but not yet noted as sent when a process died is sent again: to MLflow an equal metric (key,
    value, step, time) is the same metric, and everything else is replaced by itself.

    Args:
        run_dir: the run's folder.
    """

    def __init__(self, run_dir: Path):
        super().__init__(name="mlflow-sender", daemon=True)
        self.run_dir = run_dir
        self.target = Target.load(run_dir / "tracking" / TARGET)
        self.problem: str | None = None
        self.registered: str | None = None
        self._client: MlflowClient | None = None
        self._refused: set[str] = set()
        self._first_try, self._closing = threading.Event(), threading.Event()

    def run_id(self, patience: float) -> str | None:
        """The run's id; None when MLflow cannot be reached, or has not answered within `patience` seconds."""
        if self.target.run_id is None and not self._first_try.is_set():
            self._first_try.wait(patience)
            self._first_try.set()  # whoever asks again waits no more
        return self.target.run_id

    def close(self, seconds: float) -> bool:
        """Send what is left, for at most so many seconds; returns whether all is sent."""
        self._closing.set()
        if self.is_alive():
            self.join(seconds)
        return not self.is_alive() and self.problem is None

    def run(self) -> None:
        pause = 1.0
        while True:
            closing = self._closing.is_set()  # before sending, so that the last records are sent too
            try:
                self.send()
            except Exception as error:  # of whatever kind: tracking never stops training
                self._complain(error)
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
        """Send everything that the journal holds by now. Raises what MLflow raises when it cannot be reached."""
        if self._client is None:
            client = connected(self.target.tracking_uri)
            self._note(self.target.with_run(client))
            self._client = client
        for batch, end in _batches(self.run_dir / JOURNAL, self.target.sent):
            try:
                self._deliver(batch)
            except (MlflowException, FileNotFoundError, UserError) as error:
                if isinstance(error, MlflowException) and error.error_code not in REFUSALS:
                    raise
                self._refuse(batch[0]["kind"], error)
            self._note(replace(self.target, sent=end))

    def _deliver(self, batch: list[Record]) -> None:
        client, run, first = self._client, self.target.run_id, batch[0]
        match first["kind"]:
            case "metrics":
                found = [Metric(k, v, r["time"], r["step"]) for r in batch for k, v in r["values"].items()]
                for start in range(0, len(found), MAX_METRICS_PER_BATCH):
                    client.log_batch(run, metrics=found[start : start + MAX_METRICS_PER_BATCH])
            case "parameters":
                found = [Param(k, v) for k, v in first["values"].items()]
                for start in range(0, len(found), MAX_PARAMS_TAGS_PER_BATCH):
                    client.log_batch(run, params=found[start : start + MAX_PARAMS_TAGS_PER_BATCH])
            case "tags":
                client.log_batch(run, tags=[RunTag(k, v) for k, v in first["values"].items()])
            case "dataset":
                log_dataset(client, run, first)
            case "artifact":
                client.log_artifact(run, str(self.run_dir / first["path"]), first["folder"])
            case "model":
                version = register(client, run, self.run_dir / first["path"], first["name"])
                self.registered = f"models:/{version.name}/{version.version}"
            case "status" if first["value"] == "RUNNING":
                client.update_run(run, "RUNNING")
            case "status":
                client.set_terminated(run, first["value"], first["time"])

    def _note(self, target: Target) -> None:
        if target != self.target:
            target.write(self.run_dir / "tracking" / TARGET)
            self.target = target

    def _complain(self, error: Exception) -> None:
        """Warn once per outage of MLflow."""
        if self.problem is None:
            warnings.warn(
                f"MLflow at {self.target.tracking_uri} cannot be reached ({_line(error)}): training goes on, and "
                f"what it logs is kept in {self.run_dir / 'tracking'} and sent later",
                stacklevel=1,
            )
        self.problem = _line(error)

    def _refuse(self, kind: str, error: Exception) -> None:
        """Warn once per kind of refused record."""
        if kind not in self._refused:
            self._refused.add(kind)
            warnings.warn(f"MLflow refused {kind} ({_line(error)}): not logged", stacklevel=1)


def _batches(path: Path, start: int) -> Iterator[tuple[list[Record], int]]:
    """Batches of records, each with the byte offset of the next: metrics up to MLflow's batch limit, others singly."""
    batch, count, end = [], 0, start
    for record, following in records(path, start):
        is_metrics = record["kind"] == "metrics"
        if batch and (not is_metrics or count + len(record["values"]) > MAX_METRICS_PER_BATCH):
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


def _line(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0][:200]

"""Logger of a run without MLflow."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import DummyLogger, Logger
from lightning.pytorch.utilities import rank_zero_only

from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import code_changes, flattened, machine_tags, parameters
from rfpp.training.tracking.journal import JOURNAL, Journal, Record, records

#: File with all metrics in the run's folder.
TABLE = "metrics.csv"


class RunLogger(Logger):
    """Writes everything to the run folder's journal; resumed runs append to it.

    Metrics are also written to metrics.csv, at each checkpoint and at the end. A run that resumes with
    `logger=mlflow` sends its whole journal to MLflow. `also` is one of Lightning's loggers, for settings and metrics.
    """

    def __init__(self, run_name: str, run_dir: str | Path, also: Logger | None = None):
        super().__init__()
        self.run_dir, self._run_name, self._also = Path(run_dir), run_name, also or DummyLogger()
        self._statuses = {"success": "FINISHED", "failed": "FAILED"}  # Lightning's and MLflow's names

    @cached_property
    def _journal(self) -> Journal:
        """Journal, created on rank 0 at the first access: a run that fails before leaves nothing."""
        return self._begin()

    def _begin(self) -> Journal:
        journal = Journal(self.run_dir / JOURNAL)
        journal.append("status", value="RUNNING")
        return journal

    def _end(self) -> None:
        """Finish, after the last record."""
        self._write_table()

    @property
    def name(self) -> str:
        return self._run_name

    @property
    def version(self) -> str | None:
        return self.run_id

    @property
    def run_id(self) -> str | None:
        """MLflow's id of the run, or None."""
        return None

    @property
    def tracking_uri(self) -> str | None:
        """URI of MLflow's server or store, or None."""
        return None

    @property
    def location(self) -> str:
        """Place where the metrics are found, for summaries on rank 0."""
        return f"metrics in {self.run_dir / TABLE}"

    @rank_zero_only
    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        named = {re.sub(r"[^\w/. -]+", "", name, flags=re.ASCII): value for name, value in metrics.items()}
        named.pop("epoch", None)  # added by Lightning; training has no epochs, see GlobalBatches
        self._journal.metrics(named, step or 0)
        self._also.log_metrics(named, step or 0)

    @rank_zero_only
    def log_hyperparams(self, params: dict[str, Any]) -> None:
        self._journal.parameters(flattened(params))

    @rank_zero_only
    def log_file(self, path: Path, folder: str | None = None) -> None:
        """Log a file of the run folder as an artifact."""
        self._journal.append("artifact", path=self._relative(path), folder=folder)

    @rank_zero_only
    def register_model(self, name: str, checkpoint: Path) -> None:
        """Register a checkpoint of the run folder as the next version of a model."""
        self._journal.append("model", name=name, path=self._relative(checkpoint))

    @rank_zero_only
    def describe(self, config: dict[str, Any], config_file: Path, manifest: Manifest, tags: Mapping[str, str]) -> None:
        """Log config (as a file, and its comparable part as parameters), data set, code, machine, number of restarts.

        Settings that have changed since the run began are tags, `resumed/optimizer.lr` for instance.
        """
        changed = self._journal.parameters(parameters(config))
        self._also.log_hyperparams(config)
        tags = {**tags, **machine_tags(), "resumed": str(self._journal.starts - 1)}
        tags |= {f"resumed/{name}": value for name, value in changed.items()}
        self._journal.append("tags", values=tags)
        self.log_file(config_file, "config")
        if changes := code_changes():
            self.log_file(write_atomically(self.run_dir / "code.diff", changes.encode()), "code")
        self._journal.append(
            "dataset", name=manifest.name, digest=manifest.hash, source=str(manifest.root), counts=manifest.counts
        )

    @rank_zero_only
    def sync(self) -> None:
        """Flush to disk, see Journal.sync."""
        self._journal.sync()
        self._write_table()

    def mark_stopped(self) -> None:
        """Record at the end that the run was stopped early, to be resumed in this folder."""
        self._statuses["failed"] = "KILLED"

    @rank_zero_only
    def finalize(self, status: str) -> None:
        if "_journal" not in self.__dict__:
            return  # nothing has been logged
        self._also.finalize(status)
        self._journal.append("status", value=self._statuses[status])
        self._journal.sync()
        self._end()

    def _relative(self, path: Path) -> str:
        path, run_dir = Path(path).absolute(), self.run_dir.absolute()
        if not path.is_relative_to(run_dir):
            raise UserError(f"logger.run_dir: {path} is not in {run_dir}: set run_dir alone")
        return str(path.relative_to(run_dir))

    def _write_table(self) -> None:
        table = metrics_table(record for record, _ in records(self.run_dir / JOURNAL))
        write_atomically(self.run_dir / TABLE, table.encode())


def metrics_table(journal: Iterable[Record]) -> str:
    """Return CSV with a row per step and a column per metric; cells without a value are empty."""
    rows: dict[int, dict[str, float]] = {}
    for record in journal:
        if record["kind"] == "metrics":
            rows.setdefault(record["step"], {}).update(record["values"])
    names = sorted({name for row in rows.values() for name in row})
    text = io.StringIO()
    table = csv.DictWriter(text, ["step", *names], restval="", lineterminator="\n")
    table.writeheader()
    table.writerows({"step": step, **rows[step]} for step in sorted(rows))
    return text.getvalue()

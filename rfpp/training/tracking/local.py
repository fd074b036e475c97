"""Logger of untracked runs: metrics stay in the run's folder as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from lightning.pytorch.utilities import rank_zero_only

from rfpp.files import write_atomically
from rfpp.training.tracking.journal import JOURNAL, Record, records
from rfpp.training.tracking.run_logger import RunLogger

TABLE = "metrics.csv"


class LocalLogger(RunLogger):
    """Writes to the run folder's journal and, with every checkpoint and at the end, metrics.csv.

    Needs no MLflow. The journal is the same, so that MLflow gets all of the run when it goes on with `logger=mlflow`.

    Args: those of RunLogger.
    """

    @property
    def kept(self) -> str:
        return f"its metrics in {TABLE}"

    @property
    def whereabouts(self) -> str:
        return f"Metrics  {self.run_dir / TABLE}"

    @rank_zero_only
    def sync(self) -> None:
        super().sync()
        self._write_table()

    def _end(self) -> None:
        self._write_table()

    def _write_table(self) -> None:
        table = metrics_table(record for record, _ in records(self.run_dir / JOURNAL))
        write_atomically(self.run_dir / TABLE, table.encode())


def metrics_table(journal: Iterable[Record]) -> str:
    """CSV with a row for each step and a column for each metric, sorted; empty where a step has no such metric."""
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

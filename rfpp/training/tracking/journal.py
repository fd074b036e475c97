"""Journal of a run: a local log of everything that is sent to MLflow."""

from __future__ import annotations

import json
import os
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rfpp.errors import UserError

#: Path of the journal in a run's folder.
JOURNAL = Path("tracking") / "journal.jsonl"
#: File beside it that names the run in MLflow.
RUN_FILE = Path("tracking") / "run.json"

#: A record: its `kind`, the `time` when it was written (milliseconds since 1970), and its content.
Record = dict[str, Any]


class Journal:
    """Append-only log of records, as JSON lines.

    Each line is handed to the operating system before training continues, so a killed process loses none. A run
    resumed from a checkpoint repeats the steps after it exactly; the journal ignores repeated steps. An incomplete
    last line is removed.

    Raises:
        UserError: If the file cannot be written.
    """

    def __init__(self, path: Path):
        self.path = path
        self._lock = threading.Lock()
        self._last_steps: dict[str, int] = {}
        self._parameters: dict[str, str] = {}
        self.starts = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "ab", buffering=0)  # noqa: SIM115 (open for the whole run)
            complete = 0
            for record, following in records(path):
                self._remember(record)
                complete = following
            self._file.truncate(complete)
        except OSError as error:
            raise self._unwritable(error) from None

    def metrics(self, values: Mapping[str, float], step: int) -> None:
        """Append metrics, except those already logged at this step or a later one."""
        new = {name: float(value) for name, value in values.items() if step > self._last_steps.get(name, -1)}
        if new:
            self.append("metrics", step=step, values=new)

    def parameters(self, values: Mapping[str, str]) -> dict[str, str]:
        """Append parameters that have no value yet, and return those with another: MLflow's cannot be changed."""
        if new := {name: value for name, value in values.items() if name not in self._parameters}:
            self.append("parameters", values=new)
        return {name: value for name, value in values.items() if value != self._parameters[name]}

    def append(self, kind: str, **content: Any) -> None:
        """Append a record.

        Raises:
            UserError: If it cannot be written, e.g. because the disk is full.
        """
        record = {"kind": kind, "time": int(time.time() * 1000), **content}
        with self._lock:
            try:
                self._file.write(json.dumps(record).encode() + b"\n")
            except OSError as error:
                raise self._unwritable(error) from None
            self._remember(record)

    def sync(self) -> None:
        """Flush to disk, so that no checkpoint outlives the records of the steps before it."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()

    def _remember(self, record: Record) -> None:
        match record["kind"]:
            case "metrics":
                self._last_steps |= dict.fromkeys(record["values"], record["step"])
            case "parameters":
                self._parameters |= record["values"]
            case "status":
                self.starts += record["value"] == "RUNNING"

    def _unwritable(self, error: OSError) -> UserError:
        return UserError(
            f"{self.path}: cannot be written ({error.strerror}): free some space and run the same command again"
        )


def records(path: Path, start: int = 0) -> Iterator[tuple[Record, int]]:
    """Yield the complete records from byte `start`, each with the byte offset of the next.

    Warns about damaged lines and omits them.
    """
    with open(path, "rb") as file:
        file.seek(start)
        for line in file:
            if not line.endswith(b"\n"):
                return
            start += len(line)
            try:
                record = json.loads(line)
                record["kind"]
            except (ValueError, TypeError, KeyError):
                warnings.warn(f"{path}: damaged before byte {start}: one record is lost", stacklevel=2)
                continue
            yield record, start

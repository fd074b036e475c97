"""The journal: a local log of everything a run sends to MLflow."""

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

#: What a run folder keeps it as.
JOURNAL = Path("tracking") / "journal.jsonl"

#: A record: what it is (`kind`), when it was written (`time`, ms since 1970), and what belongs to it.
Record = dict[str, Any]


class Journal:
    """Records as JSON lines, appended and never changed.

    A line is handed to the operating system whole before training goes on, so that a killed process has lost none.
    A run that goes on from a checkpoint repeats some steps, and repeats them exactly: what is in the journal already
    is not written a second time. A last line that a crash cut short is dropped.

    Args:
        path: of the file; made with its folder where there is none.

    Raises:
        UserError: the file cannot be written.
    """

    def __init__(self, path: Path):
        self.path = path
        self._lock = threading.Lock()
        self._last_steps: dict[str, int] = {}
        self._parameters: set[str] = set()
        self.starts = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "ab", buffering=0)  # noqa: SIM115 (open as long as the run)
            self._file.truncate(_whole_lines(path))
        except OSError as error:
            raise self._unwritable(error) from None
        for record, _ in records(path):
            self._remember(record)

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return os.fstat(self._file.fileno()).st_size

    def metrics(self, values: Mapping[str, float], step: int) -> None:
        """Record what has not been recorded of this step or a later one."""
        new = {name: float(value) for name, value in values.items() if step > self._last_steps.get(name, -1)}
        if new:
            self.append("metrics", step=step, values=new)

    def parameters(self, values: Mapping[str, str]) -> None:
        """Record the parameters that have no value yet: MLflow's cannot be changed."""
        if new := {name: value for name, value in values.items() if name not in self._parameters}:
            self.append("parameters", values=new)

    def append(self, kind: str, **content: Any) -> None:
        """Append a record. Raises UserError if it cannot be written (full disk)."""
        record = {"kind": kind, "time": int(time.time() * 1000), **content}
        with self._lock:
            try:
                self._file.write(json.dumps(record).encode() + b"\n")
            except OSError as error:
                raise self._unwritable(error) from None
            self._remember(record)

    def sync(self) -> None:
        """Flush to disk. A checkpoint must not outlive the records of the steps before it."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()

    def _remember(self, record: Record) -> None:
        match record["kind"]:
            case "metrics":
                self._last_steps |= dict.fromkeys(record["values"], record["step"])
            case "parameters":
                self._parameters |= record["values"].keys()
            case "status":
                self.starts += record["value"] == "RUNNING"

    def _unwritable(self, error: OSError) -> UserError:
        return UserError(
            f"{self.path}: cannot be written ({error.strerror}): free some space and run the same command again"
        )


def records(path: Path, start: int = 0) -> Iterator[tuple[Record, int]]:
    """The records from byte `start` on, each with the byte where the next one begins; whole lines alone.

    A line that is no record is warned of and left out.
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


def _whole_lines(path: Path) -> int:
    """Bytes up to the end of the last whole line."""
    with open(path, "rb") as file:
        end = file.seek(0, os.SEEK_END)
        while end > 0:
            begin = max(end - 65536, 0)
            file.seek(begin)
            newline = file.read(end - begin).rfind(b"\n")
            if newline >= 0:
                return begin + newline + 1
            end = begin
    return 0

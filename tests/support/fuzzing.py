"""Fuzzing: how much is tried, and a table of how it ended.

In the suite a few inputs of each kind, always the same. FUZZ=900 tries so many, different ones each time, and none
may take ten seconds; FUZZ_TABLE names a file for the table. `make fuzz` sets both.
"""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import timedelta
from pathlib import Path

import torch
from hypothesis import HealthCheck, settings

from rfpp.training.tracking.description import code_version, hardware

_MANY = int(os.environ.get("FUZZ", "0"))

#: Of every test of this kind.
fuzzed = settings(
    max_examples=_MANY or 40,
    derandomize=not _MANY,
    deadline=timedelta(seconds=10) if _MANY else None,
    print_blob=bool(_MANY),
    suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
)

#: What one input may take.
MOST_GB = 2


@dataclass
class Attempts:
    """Counts for one kind of input.

    Attributes:
        tried: inputs.
        taken: of these were accepted; the others were refused in one line.
        slowest: seconds.
        memory: GB that the process held at most, beyond what it held before the input.
    """

    kind: str
    tried: int = 0
    taken: int = 0
    slowest: float = 0.0
    memory: float = 0.0


@dataclass
class Attempt:
    """One input; `taken` is set where it is accepted."""

    taken: bool = False


#: By kind, in the order of their first input.
ATTEMPTS: dict[str, Attempts] = {}


@contextmanager
def attempt(kind: str) -> Iterator[Attempt]:
    """One input: timed and counted. Fails where it took more memory than any may."""
    of_kind, one, begin = ATTEMPTS.setdefault(kind, Attempts(kind)), Attempt(), time.perf_counter()
    before = _gb("VmRSS", forget_most=True)
    yield one
    of_kind.tried += 1
    of_kind.taken += one.taken
    of_kind.slowest = max(of_kind.slowest, time.perf_counter() - begin)
    of_kind.memory = max(of_kind.memory, _gb("VmHWM") - before)
    assert of_kind.memory < MOST_GB, f"{of_kind.memory:.1f} GB"


def write_table(path: Path) -> None:
    """ATTEMPTS as CSV, with what they were tried on."""
    where = {"commit": (code_version() or "")[:12], "hardware": hardware(torch.device("cpu"))}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*(field.name for field in fields(Attempts)), *where], lineterminator="\n")
        writer.writeheader()
        for row in ATTEMPTS.values():
            rounded = {"slowest": round(row.slowest, 2), "memory": round(row.memory, 2)}
            writer.writerow(asdict(row) | rounded | where)


def _gb(name: str, forget_most: bool = False) -> float:
    """Return memory of this process on Linux in GB: VmRSS now, VmHWM at most since the last reset; else 0."""
    status = Path("/proc/self/status")
    if not status.exists():
        return 0.0
    if forget_most:
        Path("/proc/self/clear_refs").write_text("5")
    line = next(line for line in status.read_text().splitlines() if line.startswith(f"{name}:"))
    return int(line.split()[1]) / 2**20

"""Fuzzing: how much is tried, and a table of how it ended.

In the suite a few inputs of each kind, always the same. FUZZ=1200 tries so many, different ones each time, and none
may take ten seconds; FUZZ_TABLE names a file for the table. `make fuzz` sets both.
"""

from __future__ import annotations

import csv
import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import timedelta
from pathlib import Path

from hypothesis import HealthCheck, settings

_MANY = int(os.environ.get("FUZZ", "0"))

#: Of every test of this kind.
fuzzed = settings(
    max_examples=_MANY or 40,
    derandomize=not _MANY,
    deadline=timedelta(seconds=10) if _MANY else None,
    print_blob=bool(_MANY),
    suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
)

#: What one input may take beyond what the process held before the first.
MOST_GB = 2


@dataclass
class Attempts:
    """Of one kind of input.

    Attributes:
        tried: inputs.
        taken: of these were accepted; the others were refused in one line.
        slowest: seconds.
        memory: GB that the process ever held beyond what it held before the first input of all.
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
_before: list[float] = []


@contextmanager
def attempt(kind: str) -> Iterator[Attempt]:
    """One input: timed and counted. Fails where it took more memory than any may."""
    if not _before:
        _before.append(_most_gb())
    of_kind, one, begin = ATTEMPTS.setdefault(kind, Attempts(kind)), Attempt(), time.perf_counter()
    yield one
    of_kind.tried += 1
    of_kind.taken += one.taken
    of_kind.slowest = max(of_kind.slowest, time.perf_counter() - begin)
    of_kind.memory = max(of_kind.memory, _most_gb() - _before[0])
    assert of_kind.memory < MOST_GB, f"{of_kind.memory:.1f} GB"


def write_table(path: Path) -> None:
    """ATTEMPTS as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Attempts)])
        writer.writeheader()
        for row in ATTEMPTS.values():
            writer.writerow(asdict(row) | {"slowest": round(row.slowest, 2), "memory": round(row.memory, 2)})


def _most_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # in kB on Linux

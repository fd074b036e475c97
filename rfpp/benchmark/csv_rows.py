"""Read the tables of benchmarks."""

from __future__ import annotations

import csv
from collections.abc import Set
from pathlib import Path

from rfpp.errors import UserError

Row = dict[str, str | int | float | None]


def read_rows(path: Path, benchmark: str, columns: Set[str]) -> list[dict[str, str]]:
    """Read the table of a benchmark. Raises UserError if it cannot be read, is empty or lacks a column."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({error}): correct the path") from None
    if not rows or columns - rows[0].keys():
        command = f"launch/benchmark.py benchmark={benchmark} output=…"
        raise UserError(f"{path}: not a table of benchmark={benchmark}: make it with {command}")
    return rows

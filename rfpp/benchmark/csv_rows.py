"""Read the tables of benchmarks, and turn them into plots and Markdown from the command line."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Sequence, Set
from pathlib import Path
from typing import TypeVar

from rfpp.errors import UserError

Row = dict[str, str | int | float | None]
Result = TypeVar("Result", Path, str)


def read_rows(path: Path, benchmark: str, columns: Set[str]) -> list[dict[str, str]]:
    """Read the table of a benchmark.

    Raises:
        UserError: If the file cannot be read, is empty or lacks a column.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({error}): correct the path") from None
    if not rows or columns - rows[0].keys():
        command = f"launch/benchmark.py benchmark={benchmark} output=…"
        raise UserError(f"{path}: not a table of benchmark={benchmark}: make it with {command}")
    return rows


def command(
    benchmark: str, description: str | None, convert: Callable[[Path], Result], arguments: Sequence[str] | None
) -> Result:
    """Run a command that converts a benchmark's table and prints the result; errors are one line."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, help=f"table written by launch/benchmark.py benchmark={benchmark} output=…")
    try:
        result = convert(parser.parse_args(arguments).csv)
    except UserError as error:
        parser.exit(1, f"error: {error}\n")
    print(result)
    return result

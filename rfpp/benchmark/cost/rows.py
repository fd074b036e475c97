"""The table of costs: a row per case, quantity and network."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Set
from pathlib import Path
from statistics import median
from typing import Any

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import GB
from rfpp.benchmark.cost.tasks import Task
from rfpp.benchmark.cost.turns import OK, Result
from rfpp.errors import UserError

Row = dict[str, str | int | float | None]

#: Columns that say how a row was measured: rows that agree in them and in the case answer the same question.
CONDITIONS = ("device", "precision", "compiled", "threads", "torch")
COLUMNS = {"sweep", "triangles", "quantity", "network", "status", "seconds", "peak_GB", *CONDITIONS}


def read_rows(path: Path, needed: Set[str] = COLUMNS, benchmark: str = "cost") -> list[Row]:
    """A table that a benchmark wrote before. Raises UserError naming the file: it has not the `needed` columns."""
    try:
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({error}): correct the path") from None
    if not rows or needed - rows[0].keys():
        command = f"benchmark={benchmark}"
        raise UserError(f"{path}: not a table of {command}: make it with launch/benchmark.py {command} output=…")
    return rows


def rows_of(rows: Iterable[Row], case: Case, task: Task, conditions: Mapping[str, Any]) -> list[Row]:
    """Those that say what `task` costs in `case` under these conditions, of the first sweep that has it."""
    wanted = {**vars(case), **{name: conditions[name] for name in CONDITIONS}}
    found = [
        row
        for row in rows
        if row["quantity"] in task.quantities and all(str(row[name]) == str(value) for name, value in wanted.items())
    ]
    return [row for row in found if row["sweep"] == found[0]["sweep"]]


def new_rows(
    task: Task, results: Mapping[str, Result], flops: Mapping[str, dict[str, float]], rate: float
) -> list[Row]:
    """What the networks did with a task in one case.

    Args:
        results: network → its turns; the first network is the baseline.
        flops: network → quantity → operations.
        rate: what the device does in products of large matrices, TFLOP/s.
    """
    rows = []
    for quantity in task.quantities:
        measured: dict[str, dict[str, Any]] = {}
        for name, result in results.items():
            whole = quantity == task.quantities[-1]
            measured[name] = _figures(result, quantity, whole) | {"TFLOP": flops[name][quantity] / 1e12}
        baseline = next(iter(measured.values()))
        for name, own in measured.items():
            seconds, peak = own["seconds"], own["peak_GB"]
            per_second = seconds and own["TFLOP"] / seconds
            rows.append(
                {
                    "quantity": quantity,
                    "network": name,
                    **own,
                    "speedup": baseline["seconds"] / seconds if seconds and baseline["seconds"] else None,
                    "memory_saved": 1 - peak / baseline["peak_GB"] if peak and baseline["peak_GB"] else None,
                    "TFLOP_per_s": per_second,
                    "of_matrix_rate": per_second and per_second / rate,
                }
            )
    return rows


def _figures(result: Result, quantity: str, whole: bool) -> dict[str, Any]:
    if not result.turns:
        return {"status": result.status, "rounds": 0} | dict.fromkeys(("seconds", "seconds_min", "peak_GB", "held_GB"))
    seconds = result.seconds(quantity)
    return {
        "status": OK,  # a later turn that failed takes nothing from those before
        "rounds": len(seconds),
        "seconds": median(seconds),
        "seconds_min": min(seconds),
        "peak_GB": result.turns[-1].peak / GB if whole else None,
        "held_GB": result.turns[-1].held / GB if whole else None,
    }

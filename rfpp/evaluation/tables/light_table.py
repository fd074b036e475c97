"""The table of light-transport measurements."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.evaluation.measuring.light import AS_IT_IS, LightErrors
from rfpp.files import write_atomically

COLUMNS = (
    "commit", "hardware", "data", "manifest", "method", "seed", "steps", "trained_on", "bounces", "scenes",
    "further_light", "further_light_low", "further_light_high", "further_light_median", "further_energy", "log_l1",
    "log_l1_growth_exchanged_tokens", "log_l1_growth_exchanged_scene", "log_l1_growth_permuted_light",
    "log_l1_growth_no_transport",
)  # fmt: skip


#: What tells one row from another.
KEY = ("data", "method", "seed", "steps", "trained_on", "bounces")


def light_row(name: str, info: CheckpointInfo | None, errors: LightErrors) -> dict[str, Any]:
    """The row of one predictor: a checkpoint, or a method without a network."""
    further, log_l1 = errors.further(), errors.log_l1[AS_IT_IS]
    growth = {f"log_l1_growth_{what}": round(value, 4) for what, value in errors.growth().items()}
    trained = {} if info is None else {"seed": info.seed, "steps": info.steps, "trained_on": info.dataset}
    return {
        "method": name if info is None else info.method,
        **trained,
        "scenes": len(log_l1),
        "further_light": round(further.mean, 4),
        "further_light_low": round(further.low, 4),
        "further_light_high": round(further.high, 4),
        "further_light_median": round(errors.median(), 4),
        "further_energy": round(errors.energy(), 4),
        "log_l1": round(sum(log_l1) / len(log_l1), 5),
        **growth,
    }


def light_rows(file: Path) -> list[dict[str, str]]:
    """The rows of a table."""
    return list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))


def write_light_rows(rows: list[dict[str, Any]], file: Path) -> Path:
    """Write rows into a table; existing rows with the same KEY are replaced."""
    new = {tuple(str(row.get(name, "")) for name in KEY) for row in rows}
    old = light_rows(file) if file.exists() else []
    kept = [row for row in old if tuple(row.get(name, "") for name in KEY) not in new]
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows([*kept, *rows])
    return write_atomically(file, text.getvalue().encode())

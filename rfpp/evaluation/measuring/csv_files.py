"""Write records and means as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from rfpp.evaluation.measuring.confidence import Estimates
from rfpp.evaluation.measuring.records import SceneRecord
from rfpp.files import write_atomically

Row = Mapping[str, str | int | float | None]


def write_records(
    records: Sequence[SceneRecord], means: Mapping[tuple[str, str], Estimates], folder: Path
) -> list[Path]:
    """Write `images.csv`, `scenes.csv` and `summary.csv`."""
    images, scenes = [], []
    for r in records:
        where = {"split": r.split, "scene": r.scene}
        images += [{**where, "view": n, "predictor": r.predictor, **view} for n, view in enumerate(r.views)]
        sizes = {"triangles": r.triangles, "objects": r.objects, "lights": r.lights}
        scenes.append({**where, **sizes, "predictor": r.predictor, **r.values})
    summary = []
    for (split, who), values in means.items():
        summary.append({"split": split, "predictor": who, "scenes": next(iter(values.values())).scenes})
        for name, estimate in values.items():
            summary[-1] |= {name: estimate.mean, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    tables = {"images.csv": images, "scenes.csv": scenes, "summary.csv": summary}
    return [write_rows(folder / name, rows) for name, rows in tables.items()]


def write_rows(path: Path, rows: Sequence[Row]) -> Path:
    """Write a CSV file with floats of seven digits. A key missing from a row is an empty cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer.writerow(names)
    for row in rows:
        cells = [row.get(name) for name in names]
        writer.writerow(f"{cell:.7g}" if isinstance(cell, float) else cell for cell in cells)
    return write_atomically(path, stream.getvalue().encode())

"""Records, means and buckets as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rfpp.evaluation.buckets import Bucket
from rfpp.evaluation.confidence import Estimates
from rfpp.evaluation.records import ImageRecord, SceneRecord
from rfpp.scene.files import write_atomically

Row = Mapping[str, str | int | float | None]


def write_records(images: Sequence[ImageRecord], scenes: Sequence[SceneRecord], folder: Path) -> list[Path]:
    """`<split>.csv` (per image) and `<split>_scenes.csv` (per scene) for each split; returns their paths.

    Raises:
        UserError: a file cannot be written.
    """
    files = []
    for split in dict.fromkeys(record.split for record in images):
        of_images = [
            {"scene": r.scene, "view": r.view, "predictor": r.predictor, **r.values} for r in images if r.split == split
        ]
        of_scenes = [
            {"scene": r.scene, "triangles": r.triangles, "objects": r.objects, "predictor": r.predictor, **r.values}
            for r in scenes
            if r.split == split
        ]
        files += [write_rows(folder / f"{split}.csv", of_images), write_rows(folder / f"{split}_scenes.csv", of_scenes)]
    return files


def write_summary(means: Mapping[tuple[str, str], Estimates], folder: Path) -> Path:
    """`summary.csv`: a row per split and predictor; `<metric>`, `<metric>_low` and `<metric>_high` in columns.

    Raises:
        UserError: the file cannot be written.
    """
    rows = [{"split": split, "predictor": who, **_columns(values)} for (split, who), values in means.items()]
    return write_rows(folder / "summary.csv", rows)


def write_buckets(buckets: Sequence[Bucket], folder: Path) -> Path:
    """`buckets.csv`: a row per bucket that holds a scene, columns as in `summary.csv`.

    Raises:
        UserError: the file cannot be written.
    """
    rows = [
        {"split": b.split, "counted": b.counted, "from": b.start, "below": b.stop, **_columns(b.estimates)}
        for b in buckets
    ]
    return write_rows(folder / "buckets.csv", rows)


def write_rows(path: Path, rows: Sequence[Row]) -> Path:
    """A CSV file of rows with the same keys, numbers to seven digits; returns its path.

    Raises:
        UserError: it cannot be written.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(rows[0])
    writer.writerows(_cells(row.values()) for row in rows)
    return write_atomically(path, stream.getvalue().encode())


def _columns(values: Estimates) -> Row:
    columns: dict[str, float] = {"scenes": next(iter(values.values())).scenes}
    for name, estimate in values.items():
        columns |= {name: estimate.mean, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    return columns


def _cells(values: Iterable[str | int | float | None]) -> list[str | int | None]:
    return [f"{value:.7g}" if isinstance(value, float) else value for value in values]

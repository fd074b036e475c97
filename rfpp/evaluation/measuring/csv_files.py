"""Read and write records, means and buckets as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from rfpp.errors import UserError
from rfpp.evaluation.measuring.buckets import Bucket
from rfpp.evaluation.measuring.confidence import Estimate, Estimates
from rfpp.evaluation.measuring.records import ImageRecord, SceneRecord
from rfpp.files import write_atomically

BUCKETS_FILE = "buckets.csv"

Row = Mapping[str, str | int | float | None]
Content = TypeVar("Content")


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
            {
                **{name: getattr(r, name) for name in ("scene", "triangles", "objects", "lights", "predictor")},
                **r.values,
            }
            for r in scenes
            if r.split == split
        ]
        files += [write_rows(folder / f"{split}.csv", of_images), write_rows(folder / f"{split}_scenes.csv", of_scenes)]
    return files


def read_scenes(folder: Path, split: str, metrics: Sequence[str]) -> list[SceneRecord]:
    """The records in `<split>_scenes.csv`. Raises UserError naming the file: absent, or without these `metrics`."""
    return _read(
        folder / f"{split}_scenes.csv",
        lambda row: SceneRecord(
            split, row["scene"], *(int(row[name]) for name in ("triangles", "objects", "lights")), row["predictor"],
            {name: float(row[name]) for name in metrics},
        ),
    )  # fmt: skip


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
    return write_rows(folder / BUCKETS_FILE, rows)


def read_buckets(folder: Path, metrics: Sequence[str]) -> list[Bucket]:
    """The buckets in `buckets.csv`. Raises UserError naming the file: absent, or without these `metrics`."""
    return _read(
        folder / BUCKETS_FILE,
        lambda row: Bucket(
            row["split"], row["counted"], int(row["from"]), int(row["below"]) if row["below"] else None,
            {name: _estimate(row, name) for name in metrics},
        ),
    )  # fmt: skip


def write_rows(path: Path, rows: Sequence[Row]) -> Path:
    """A CSV file of rows, numbers to seven digits; returns its path. A key that a row has not got is an empty cell.

    Raises:
        UserError: it cannot be written.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer.writerow(names)
    writer.writerows(_cells(row.get(name) for name in names) for row in rows)
    return write_atomically(path, stream.getvalue().encode())


def _read(path: Path, content: Callable[[Mapping[str, str]], Content]) -> list[Content]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [content(row) for row in csv.DictReader(file)]
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): make it with launch/evaluate.py") from None
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise UserError(f"{path}: not what launch/evaluate.py writes ({error!r}): make it again") from None


def _estimate(row: Mapping[str, str], name: str) -> Estimate:
    return Estimate(*(float(row[column]) for column in (name, f"{name}_low", f"{name}_high")), int(row["scenes"]))


def _columns(values: Estimates) -> Row:
    columns: dict[str, float] = {"scenes": next(iter(values.values())).scenes}
    for name, estimate in values.items():
        columns |= {name: estimate.mean, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
    return columns


def _cells(values: Iterable[str | int | float | None]) -> list[str | int | None]:
    return [f"{value:.7g}" if isinstance(value, float) else value for value in values]

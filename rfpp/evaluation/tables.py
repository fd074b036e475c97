"""From per-image records to means, CSV files and a printed table."""

from __future__ import annotations

import csv
import io
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from rfpp.metrics.image import METRICS
from rfpp.scene.files import write_atomically

Values = Mapping[str, float]


@dataclass(frozen=True)
class ImageRecord:
    """What one predictor scored on one image.

    Attributes:
        split, scene, view: which image.
        predictor: "model" or the name of a baseline.
        values: by metric name.
    """

    split: str
    scene: str
    view: int
    predictor: str
    values: Values


def scene_means(records: Iterable[ImageRecord]) -> dict[tuple[str, str, str], dict[str, float]]:
    """Mean over the views of each scene, by (split, predictor, scene)."""
    return _means(((r.split, r.predictor, r.scene), r.values) for r in records)


def split_means(records: Iterable[ImageRecord]) -> dict[tuple[str, str], dict[str, float]]:
    """Mean over the scenes of each split, every scene counting the same, by (split, predictor)."""
    return _means(((split, predictor), values) for (split, predictor, _), values in scene_means(records).items())


def write_csv(records: Sequence[ImageRecord], folder: Path) -> list[Path]:
    """`<split>.csv` (per image) and `<split>_scenes.csv` for each split, and `summary.csv`; returns their paths.

    Raises:
        UserError: a file cannot be written.
    """
    files = []
    for split in dict.fromkeys(record.split for record in records):
        mine = [record for record in records if record.split == split]
        images = [((r.scene, r.view, r.predictor), r.values) for r in mine]
        scenes = [((scene, who), values) for (_, who, scene), values in scene_means(mine).items()]
        files.append(_write(folder / f"{split}.csv", ("scene", "view", "predictor"), images))
        files.append(_write(folder / f"{split}_scenes.csv", ("scene", "predictor"), scenes))
    files.append(_write(folder / "summary.csv", ("split", "predictor"), list(split_means(records).items())))
    return files


def results_table(means: Mapping[tuple[str, str], Values]) -> Group:
    """What to print: a table per split, the best value of each column bold; the metrics' definitions beneath."""
    names = [name for name in METRICS if any(name in values for values in means.values())]
    splits = dict.fromkeys(split for split, _ in means)
    tables = [_split_table(s, {who: v for (split, who), v in means.items() if split == s}, names) for s in splits]
    notes = [f"{METRICS[name].label}: {METRICS[name].definition}" for name in names]
    legend = "\n".join(["x: prediction, y: reference, I: either of them. Means over scenes.", *notes])
    return Group(*tables, Text(legend, style="dim"))


def _split_table(split: str, rows: Mapping[str, Values], names: Sequence[str]) -> Table:
    table = Table(title=split, title_justify="left", title_style="bold")
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(f"{METRICS[name].label} {'↑' if METRICS[name].higher_is_better else '↓'}", justify="right")
    best = {name: _best(name, [values[name] for values in rows.values()]) for name in names}
    for predictor, values in rows.items():
        table.add_row(predictor, *(_cell(name, values[name], values[name] == best[name]) for name in names))
    return table


def _means(rows: Iterable[tuple[tuple, Values]]) -> dict[tuple, dict[str, float]]:
    grouped = defaultdict(list)
    for key, values in rows:
        grouped[key].append(values)
    return {key: _mean(group) for key, group in grouped.items()}


def _mean(group: Sequence[Values]) -> dict[str, float]:
    return {name: sum(values[name] for values in group) / len(group) for name in group[0]}


def _write(path: Path, key_names: Sequence[str], rows: Sequence[tuple[tuple, Values]]) -> Path:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    metric_names = list(rows[0][1])
    writer.writerow([*key_names, *metric_names])
    writer.writerows([*key, *(f"{values[name]:.7g}" for name in metric_names)] for key, values in rows)
    return write_atomically(path, stream.getvalue().encode())


def _best(name: str, values: Sequence[float]) -> float:
    finite = [value for value in values if not math.isnan(value)]
    return (max if METRICS[name].higher_is_better else min)(finite, default=math.nan)


def _cell(name: str, value: float, is_best: bool) -> Text:
    return Text(f"{value:.{METRICS[name].decimals}f}", style="bold green" if is_best else "")

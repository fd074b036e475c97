"""Tables printed by an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from rfpp.evaluation.measuring.buckets import Bucket
from rfpp.evaluation.measuring.confidence import Estimate, Estimates
from rfpp.evaluation.measuring.number_text import best_value, number_text
from rfpp.evaluation.measuring.records import MODEL
from rfpp.metrics.image import METRICS

#: Metrics of one table: so many fit into 80 characters.
_SIDE_BY_SIDE = 6
LEGEND = "x: prediction, y: reference, I: either of them. Means over scenes; ±: half their 95% interval."


def results_table(means: Mapping[tuple[str, str], Estimates], buckets: Sequence[Bucket]) -> Group:
    """What to print: a table per split, the best value of each column bold; the metrics' definitions beneath.

    The model's confidence stands under its means, and its means by the size of the scene in a second table.
    """
    names = [name for name in METRICS if any(name in values for values in means.values())]
    tables = []
    for split in dict.fromkeys(split for split, _ in means):
        of_split = [bucket for bucket in buckets if bucket.split == split]
        for start in range(0, len(names), _SIDE_BY_SIDE):
            part = names[start : start + _SIDE_BY_SIDE]
            tables.append(_split_table(split, {who: v for (s, who), v in means.items() if s == split}, part))
            if of_split:
                tables.append(_bucket_table(split, of_split, part))
    notes = [f"{METRICS[name].label}: {METRICS[name].definition}" for name in names]
    return Group(*tables, Text("\n".join([LEGEND, *notes]), style="dim"))


def _split_table(split: str, rows: Mapping[str, Estimates], names: Sequence[str]) -> Table:
    scenes = next(iter(next(iter(rows.values())).values())).scenes
    table = _table(f"{split}, {scenes} scenes", names)
    best = {name: best_value(name, (values[name].mean for values in rows.values())) for name in names}
    for predictor, values in rows.items():
        table.add_row(predictor, *(_cell(name, values[name], values[name].mean == best[name]) for name in names))
        if predictor == MODEL:
            table.add_row("", *(Text(f"± {number_text(name, values[name].margin)}", style="dim") for name in names))
    return table


def _bucket_table(split: str, buckets: Sequence[Bucket], names: Sequence[str]) -> Table:
    table = _table(f"{split}, the model by the size of the scene", names, "scenes")
    for counted in dict.fromkeys(bucket.counted for bucket in buckets):
        table.add_row(Text(counted, style="bold"))
        for bucket in (b for b in buckets if b.counted == counted):
            values = bucket.estimates
            scenes = str(next(iter(values.values())).scenes)
            table.add_row(bucket.label, scenes, *(_cell(name, values[name], False) for name in names))
        table.add_section()
    return table


def _table(title: str, names: Sequence[str], *before: str) -> Table:
    # without lines around and between the columns six metrics fit into 80 characters, where lines would cut numbers off
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for heading in (*before, *(METRICS[name].heading for name in names)):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _cell(name: str, value: Estimate, is_best: bool) -> Text:
    return Text(number_text(name, value.mean), style="bold green" if is_best else "")

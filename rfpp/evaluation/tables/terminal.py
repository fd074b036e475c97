"""Tables that an evaluation prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from rfpp.evaluation.measuring.confidence import Estimates
from rfpp.evaluation.measuring.number_text import best_value, number_text
from rfpp.evaluation.measuring.records import MODEL
from rfpp.metrics.image import METRICS

#: Metrics per table that fit into 80 characters.
_SIDE_BY_SIDE = 6
_LEGEND = "x: prediction, y: reference, I: either of them. Means over scenes; ±: half their 95% interval."


def results_table(means: Mapping[tuple[str, str], Estimates]) -> Group:
    """Build a table per split, with the best value of each column in bold, and the metrics' definitions."""
    names = [name for name in METRICS if any(name in values for values in means.values())]
    tables = []
    for split in dict.fromkeys(split for split, _ in means):
        rows = {who: values for (of, who), values in means.items() if of == split}
        for start in range(0, len(names), _SIDE_BY_SIDE):
            tables.append(_table(split, rows, names[start : start + _SIDE_BY_SIDE]))
    notes = [f"{METRICS[name].label}: {METRICS[name].definition}" for name in names]
    return Group(*tables, Text("\n".join([_LEGEND, *notes]), style="dim"))


def _table(split: str, rows: Mapping[str, Estimates], names: Sequence[str]) -> Table:
    scenes = next(iter(next(iter(rows.values())).values())).scenes
    # with lines between the columns, six metrics would not fit into 80 characters
    table = Table(
        title=f"{split}, {scenes} scenes",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=0,
    )
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(METRICS[name].heading, justify="right", no_wrap=True)
    best = {name: best_value(name, (values[name].mean for values in rows.values())) for name in names}
    for predictor, values in rows.items():
        cells = [(number_text(name, values[name].mean), values[name].mean == best[name]) for name in names]
        table.add_row(predictor, *(Text(text, style="bold green" if is_best else "") for text, is_best in cells))
        if predictor == MODEL:
            table.add_row("", *(Text(f"±{number_text(name, values[name].margin)}", style="dim") for name in names))
    return table

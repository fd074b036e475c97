"""Lay out a table of results as text cells and footnotes, independent of the output format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rfpp.evaluation.measuring.disabled_parts import growth_text
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.number_text import EMPTY, interval_text, number_text
from rfpp.evaluation.tables.rows import ResultTable, Row, Run
from rfpp.metrics.image import METRICS

#: What the lines of a row mean.
LEGEND = (
    "95% interval: percentile bootstrap over scenes. Where a number is a mean over splits or data sets, each counts "
    "the same, and intervals are joined in quadrature; over seeds, which share their scenes, intervals are averaged. "
    "sd: standard deviation of the seeds' means."
)
NAMES = "x: prediction, y: reference, I: either of them. Metrics are means over the views of a scene, then over scenes."


@dataclass(frozen=True)
class Layout:
    """The text of a table.

    Attributes:
        title: caption.
        groups: heading → how many columns it spans; two columns of labels come before.
        headings: of all columns.
        blocks: heading → lines, each with a cell for every column.
        notes: what stands beneath, a line each.
    """

    title: str
    groups: Mapping[str, int]
    headings: Sequence[str]
    blocks: Sequence[tuple[str, Sequence[Sequence[str]]]]
    notes: Sequence[str]


def lay_out(table: ResultTable) -> Layout:
    """Lines for the paper's numbers, ours, their interval, and their spread over seeds."""
    columns = [(group, name) for group in range(len(table.groups)) for name in table.metrics]
    notes: list[str] = []
    blocks = [(h, [line for row in rows for line in _lines(row, columns, notes)]) for h, rows in table.blocks]
    return Layout(
        title=table.title,
        groups=dict.fromkeys(table.groups, len(table.metrics)),
        headings=["Method", "", *(METRICS[name].heading for _, name in columns)],
        blocks=blocks,
        notes=[*notes, LEGEND, NAMES, *(f"{METRICS[n].label}: {METRICS[n].definition}." for n in table.metrics)],
    )


def training_text(run: Run, paper_steps: int | None = None) -> str:
    """E.g. "27K of the paper's 500K steps on small_scale"; without the paper's where ours are no fewer."""
    steps = run.evaluations[0].steps
    if steps is None:
        return f"trained on {run.evaluations[0].trained_on}"
    fraction = f" of the paper's {_thousands(paper_steps)}" if paper_steps and steps < paper_steps else ""
    return f"{_thousands(steps)}{fraction} steps on {run.evaluations[0].trained_on}"


def cost_text(run: Run) -> str:
    """E.g. ", 0.66 s and 2.1 GiB each", the mean over its seeds; nothing where it is not known of all of them."""
    costs = [evaluation.cost for evaluation in run.evaluations]
    if not all(costs):
        return ""
    seconds, memory = np.mean([(cost.seconds, cost.memory) for cost in costs], axis=0)
    return f", {seconds:.2g} s and {memory:.2g} GiB each"


def _lines(row: Row, columns: Sequence[tuple[int, str]], notes: list[str]) -> Iterator[list[str]]:
    """The lines of one row; notes on its runs are appended to `notes`."""
    label = row.label
    if row.paper is not None:
        yield [label, "paper", *(number_text(name, row.paper[group][name]) for group, name in columns)]
        label = ""
    if not row.runs:
        yield [label, "ours: not run", *(EMPTY for _ in columns)]
    for run in row.runs:
        values = [run.columns[group].means.get(name) for group, name in columns]
        means = [
            EMPTY if v is None else number_text(name, v.mean) for v, (_, name) in zip(values, columns, strict=True)
        ]
        if row.is_baseline:
            yield [label, "baseline", *means]
            continue
        notes.append(f"[{len(notes) + 1}] {_description(run)}")
        yield [label, f"ours [{len(notes)}]: {training_text(run, row.paper_steps)}{cost_text(run)}", *means]
        yield ["", "95% interval", *(interval_text(name, v) for v, (_, name) in zip(values, columns, strict=True))]
        if len(run.seeds) > 1:
            spread = [run.columns[group].deviations.get(name) for group, name in columns]
            texts = [EMPTY if v is None else number_text(name, v) for v, (_, name) in zip(spread, columns, strict=True)]
            yield ["", f"sd of {len(run.seeds)} seeds", *texts]
        label = ""


def _description(run: Run) -> str:
    first = run.evaluations[0]
    seeds = ", ".join(map(str, run.seeds))
    by_data = {e.data: e for e in run.evaluations}
    hardware = " and ".join(dict.fromkeys(e.hardware for e in run.evaluations))
    return (
        f"{training_text(run)}, seed{'s' * (len(run.seeds) > 1)} {seeds}, commit {first.commit or 'unknown'}; "
        f"evaluated on {' and '.join(map(_data, by_data.values()))}, by {hardware}.{_life(run)}"
    )


def _life(run: Run) -> str:
    """Use of network parts by the first seed's network, on the last split."""
    of_splits = list(run.evaluations[0].life.values())
    return f" Seed {run.evaluations[0].seed}: {growth_text(of_splits[-1])}." if of_splits and of_splits[-1] else ""


def _data(e: Evaluation) -> str:
    scenes = {split: next(iter(values.values())).scenes for (split, _), values in e.means.items()}
    counts = ", ".join(f"{split} {count} scenes" for split, count in scenes.items())
    return f"{e.data} (manifest {e.data_manifest[:12]}; {counts})"


def _thousands(count: int) -> str:
    return f"{count // 1000}K" if count and count % 1000 == 0 else str(count)

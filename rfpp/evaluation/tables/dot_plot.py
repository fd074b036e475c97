"""Plot a table of results: methods from best to worst, one dot per seed."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rfpp.evaluation.measuring.records import MODEL
from rfpp.evaluation.tables.rows import ResultTable, Row, Run
from rfpp.metrics.image import METRICS

#: Those of the table's metrics that have a panel, the first of them orders the methods.
PLOTTED = ("log_l1", "l1_direct", "l1_indirect", "lpips", "gradient")

_TRAINED, _BASELINE = "tab:blue", "0.6"
_PANEL_WIDTH, _LINE_HEIGHT, _HEADING_HEIGHT, _LETTER_WIDTH = 2.3, 0.24, 0.9, 0.09  # inches


@dataclass(frozen=True)
class Line:
    """A method in the picture.

    Attributes:
        label: of the axis.
        run: ours.
        is_baseline: nothing in it was trained.
    """

    label: str
    run: Run
    is_baseline: bool


def lines(rows: Sequence[Row], metric: str) -> list[Line]:
    """All measured methods, best first; several trainings of one method are labelled by their steps."""
    runs = [(row, run) for row in rows for run in row.runs if metric in run.columns[-1].means]
    found = [Line(_label(row, run), run, row.is_baseline) for row, run in runs]
    sign = -1 if METRICS[metric].higher_is_better else 1
    return sorted(found, key=lambda line: sign * line.run.columns[-1].means[metric].mean)


def figure(table: ResultTable) -> Figure | None:
    """One row of panels per block of the table, for its last split; None if nothing was measured.

    A dot is a seed, a bar the 95% interval of their mean over scenes.
    """
    metrics = [name for name in PLOTTED if name in table.metrics]
    blocks = [(heading, lines(rows, metrics[0])) for heading, rows in table.blocks] if metrics else []
    blocks = [(heading, found) for heading, found in blocks if found]
    if not blocks:
        return None
    split = list(table.groups)[-1]
    heights = [_HEADING_HEIGHT + _LINE_HEIGHT * len(found) for _, found in blocks]
    labels = _LETTER_WIDTH * max(len(line.label) for _, found in blocks for line in found)
    made = Figure(figsize=(labels + _PANEL_WIDTH * len(metrics), sum(heights)), dpi=120, layout="constrained")
    grid = made.subplots(len(blocks), len(metrics), squeeze=False, height_ratios=heights)
    for (heading, found), panels in zip(blocks, grid, strict=True):
        for metric, axes in zip(metrics, panels, strict=True):
            _draw(axes, found, split, metric)
        panels[0].set_yticks(range(len(found)), [line.label for line in found])
        panels[0].set_title(f"{heading}, {split}", loc="left", fontsize="medium", pad=18)
    return made


def png(made: Figure) -> bytes:
    """The picture as a file's content."""
    stream = io.BytesIO()
    made.savefig(stream, format="png")
    return stream.getvalue()


def _draw(axes: Axes, found: Sequence[Line], split: str, metric: str) -> None:
    for height, line in enumerate(found):
        estimate = line.run.columns[-1].means.get(metric)
        if estimate is None:
            continue
        colour = _BASELINE if line.is_baseline else _TRAINED
        axes.hlines(height, estimate.low, estimate.high, colour, linewidth=3, alpha=0.3)
        seeds = [e.means[split, MODEL][metric].mean for e in line.run.evaluations if not line.is_baseline]
        axes.plot(seeds or [estimate.mean], [height] * len(seeds or [0]), "o", color=colour, markersize=4)
    axes.set(ylim=(len(found) - 0.5, -0.5), yticks=[])
    axes.set_xlabel(METRICS[metric].heading)
    axes.grid(axis="x", alpha=0.3)


def _label(row: Row, run: Run) -> str:
    return row.label if len(row.runs) < 2 else f"{row.label}, {run.evaluations[0].steps} steps"

"""Plot error over time of a renderer and of Cycles, and compare their times at equal error.

python -m rfpp.benchmark.equal_time_plot data/results/equal_time.csv
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from rich.console import Console
from rich.table import Table

from rfpp.benchmark.csv_rows import read_rows
from rfpp.errors import UserError
from rfpp.files import write_atomically

#: Panel → column of its seconds, and columns of its errors; the first error is drawn.
_PANELS = {
    "first image": ("first_s", ("log_l1", "flip")),
    "next view": ("view_s", ("log_l1", "flip")),
    "after an edit": ("edit_s", ("log_l1", "flip")),
    "frame of an animation": ("frame_s", ("flicker",)),
}
_COLUMNS = {"scene", "method", "samples", "first_s", "view_s", "edit_s", "log_l1", "flip"}
_LABELS = {"log_l1": "log-L1", "flip": "ꟻLIP", "flicker": "flicker"}

Rows = Sequence[dict[str, str]]


def plot(path: Path) -> Path:
    """Print times at equal error and save a plot beside the table. Raises UserError naming the file."""
    rows = read_rows(path, "equal_time", _COLUMNS)
    panels = {title: columns for title, columns in _PANELS.items() if columns[0] in rows[0]}
    size = (4.2 * len(panels), 4)
    figure, [axes] = plt.subplots(1, len(panels), figsize=size, constrained_layout=True, squeeze=False)
    for axis, (title, (seconds, errors)) in zip(axes, panels.items(), strict=True):
        _draw(axis, rows, seconds, errors[0])
        axis.set_title(title)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    Console(width=120).print(_times(rows, panels))
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    plt.close(figure)
    return write_atomically(path.with_suffix(".png"), stream.getvalue())


def times_at_equal_error(rows: Rows, method: str, seconds: str, error: str) -> list[float]:
    """Return, for each scene, a method's time divided by the time of Cycles at the same error.

    The time of Cycles is interpolated between sample counts in logarithms; outside of them it is that of the fewest or
    the most samples.
    """
    ratios = []
    for own in (row for row in rows if row["method"] == method):
        cycles = [row for row in rows if row["scene"] == own["scene"] and _is_cycles(row)]
        points = sorted((float(row[error]), float(row[seconds])) for row in cycles)
        as_good = np.exp(np.interp(np.log(float(own[error])), *np.log(points).T))
        ratios.append(float(own[seconds]) / float(as_good))
    return ratios


def _is_cycles(row: dict[str, str]) -> bool:
    return row["samples"] not in ("", "0")


def _times(rows: Rows, panels: dict[str, tuple[str, tuple[str, ...]]]) -> Table:
    """Return geometric means over scenes, with minimum and maximum."""
    table = Table("", "error", *panels, box=None, title_justify="left")
    table.title = "Time divided by that of Cycles at the same error (beyond its most samples: by that of the most)"
    for method in dict.fromkeys(row["method"] for row in rows if not _is_cycles(row)):
        for error, label in _LABELS.items():
            cells = []
            for seconds, errors in panels.values():
                ratios = times_at_equal_error(rows, method, seconds, error) if error in errors else []
                mean = np.exp(np.mean(np.log(ratios))) if ratios else 0
                cells.append(f"{mean:.2f} ({min(ratios):.2f}–{max(ratios):.2f})" if ratios else "")
            if any(cells):
                table.add_row(method, label, *cells)
    return table


def _draw(axis: Axes, rows: Rows, seconds: str, error: str) -> None:
    """Draw a line of Cycles and stars of the renderer for each scene."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    for scene, color in zip(scenes, plt.get_cmap("tab10").colors, strict=False):
        for is_cycles, style, size, name in [(True, ".-", 6, "Cycles, denoised"), (False, "*:", 13, "ours")]:
            found = [row for row in rows if row["scene"] == scene and _is_cycles(row) == is_cycles]
            points = sorted((float(row[seconds]), float(row[error])) for row in found)
            label = f"{scene}: {name}"
            axis.plot(*zip(*points, strict=True), style, color=color, markersize=size, linewidth=1, label=label)
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel=_LABELS[error])
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1, 2, 5)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.grid(which="both", alpha=0.2)


def main(arguments: Sequence[str] | None = None) -> Path:
    """Run the command of the module's docstring; errors are one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, help="table written by launch/benchmark.py benchmark=equal_time output=…")
    try:
        picture = plot(parser.parse_args(arguments).csv)
    except UserError as error:
        parser.exit(1, f"error: {error}\n")
    print(picture)
    return picture


if __name__ == "__main__":
    main()

"""Error over time of a network and of Cycles with few samples, from the CSV file of the benchmark.

python -m rfpp.benchmark.equal_time_plot data/results/equal_time.csv     writes a picture beside it, and prints times
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from rich.console import Console
from rich.table import Table

from rfpp.benchmark import plotting
from rfpp.errors import UserError

#: Panel → the column of its seconds, and those of its errors, the first of which is drawn.
_PANELS = {
    "a first picture": ("first_s", ("log_l1", "flip")),
    "the next view": ("view_s", ("log_l1", "flip")),
    "after an edit": ("edit_s", ("log_l1", "flip")),
    "a film's frame": ("frame_s", ("flicker",)),
}
_LABELS = {"log_l1": "log-L1", "flip": "ꟻLIP", "flicker": "flicker"}

Rows = Sequence[dict[str, str]]


def plot(file: Path) -> Path:
    """A panel for each kind of picture: a line of Cycles for each scene, a star for the network; returns the PNG.

    Raises UserError: the file cannot be read, or is not of this benchmark.
    """
    try:
        rows = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
        scenes = list(dict.fromkeys(row["scene"] for row in rows))
        # films may have been left out
        measured = {title: columns for title, columns in _PANELS.items() if columns[0] in rows[0]}
        size = (4.2 * len(measured), 4)
        figure, [panels] = plt.subplots(1, len(measured), figsize=size, constrained_layout=True, squeeze=False)
        for panel, (title, (seconds, errors)) in zip(panels, measured.items(), strict=True):
            _draw(panel, rows, scenes, seconds, errors[0])
            panel.set_title(title)
        times = _times(rows, measured)
    except (OSError, IndexError, KeyError, ValueError) as error:
        raise UserError(f"{file}: not a table of benchmark=equal_time ({error}): measure it first") from None
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    Console(width=120).print(times)
    return plotting.saved(figure, file)


def times_at_equal_error(rows: Rows, method: str, seconds: str, error: str) -> list[float]:
    """A network's method takes so many times as long as Cycles of the same error, in each scene.

    Between numbers of samples, Cycles' time is interpolated, logarithm over logarithm; outside, it is that of the
    fewest or the most.
    """
    times = []
    for mine in (row for row in rows if row["method"] == method):
        cycles = [row for row in rows if row["scene"] == mine["scene"] and int(row["samples"])]
        points = sorted((float(row[error]), float(row[seconds])) for row in cycles)
        as_good = np.exp(np.interp(np.log(float(mine[error])), *np.log(points).T))
        times.append(float(mine[seconds]) / float(as_good))
    return times


def _times(rows: Rows, panels: dict[str, tuple[str, tuple[str, ...]]]) -> Table:
    """Geometric means over scenes, with the least and the largest."""
    table = Table("", "error", *panels, box=None, title_justify="left")
    table.title = (
        "Time divided by Cycles' for the same error; where no number of samples reaches it, by that of the most"
    )
    for method in dict.fromkeys(row["method"] for row in rows if not int(row["samples"])):
        for error, label in _LABELS.items():
            cells = [
                _summary(times_at_equal_error(rows, method, seconds, error)) if error in errors else ""
                for seconds, errors in panels.values()
            ]
            if any(cells):
                table.add_row(method, label, *cells)
    return table


def _summary(times: Sequence[float]) -> str:
    return f"{np.exp(np.mean(np.log(times))):.2f} ({min(times):.2f}–{max(times):.2f})"


def _draw(panel: Axes, rows: Rows, scenes: Sequence[str], seconds: str, error: str) -> None:
    for scene, colour in zip(scenes, plt.get_cmap("tab10").colors, strict=False):
        mine = [row for row in rows if row["scene"] == scene]
        cycles = sorted((float(row[seconds]), float(row[error])) for row in mine if int(row["samples"]))
        ours = sorted((float(row[seconds]), float(row[error])) for row in mine if not int(row["samples"]))
        panel.plot(*zip(*cycles, strict=True), ".-", color=colour, linewidth=1, label=f"{scene}: Cycles, denoised")
        panel.plot(*zip(*ours, strict=True), "*:", color=colour, markersize=13, label=f"{scene}: rfpp")
    panel.set(xscale="log", yscale="log", xlabel="seconds", ylabel=_LABELS[error])
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panel.grid(which="both", alpha=0.2)


def main(arguments: Sequence[str] | None = None) -> Path:
    """See `plotting.command`."""
    return plotting.command("equal_time", __doc__, plot, arguments)


if __name__ == "__main__":
    main()

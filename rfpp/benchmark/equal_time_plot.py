"""Error over time of a network and of Cycles with few samples, from the CSV file of the benchmark.

python -m rfpp.benchmark.equal_time_plot data/results/equal_time.csv     writes a picture beside it
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from rfpp.benchmark import plotting
from rfpp.errors import UserError

#: Panel → the column of its seconds, and that of its errors.
_PANELS = {
    "a first picture": ("first_s", "log_l1"),
    "the next view": ("view_s", "log_l1"),
    "after an edit": ("edit_s", "log_l1"),
    "a film's frame": ("frame_s", "flicker"),
}
_LABELS = {"log_l1": "log-L1", "flicker": "flicker"}


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
        for panel, (title, columns) in zip(panels, measured.items(), strict=True):
            _draw(panel, rows, scenes, *columns)
            panel.set_title(title)
    except (OSError, IndexError, KeyError, ValueError) as error:
        raise UserError(f"{file}: not a table of benchmark=equal_time ({error}): measure it first") from None
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return plotting.saved(figure, file)


def _draw(panel: Axes, rows: Sequence[dict[str, str]], scenes: Sequence[str], seconds: str, error: str) -> None:
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

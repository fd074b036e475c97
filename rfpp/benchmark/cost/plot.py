"""The plot of cost over triangles, from the CSV file of the benchmark.

python -m rfpp.benchmark.cost.plot data/results/cost.csv
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rfpp.benchmark import plotting
from rfpp.benchmark.cost.rows import Row, read_rows
from rfpp.errors import UserError

#: The sweep that is plotted, and the range of triangles in which the exponent is fitted.
SWEEP = "triangles"
FITTED = (10_000, 80_000)

_COLOURS = ("tab:red", "tab:blue")
#: Panel → its label and column, and its quantities with their lines.
_PANELS = {
    "View-independent stage": ("s", "seconds", {"encode": "-"}),
    "Rendering a view": ("s", "seconds", {"render": "-"}),
    "Training step": ("s", "seconds", {"training_step": "-", "checkpointed_training_step": "--"}),
    "Peak memory": (
        "GB", "peak_GB",
        {"render": ":", "training_step": "-", "checkpointed_training_step": "--", "least_memory_training_step": "-."},
    ),
}  # fmt: skip
_NAMES = {
    "training_step": "training",
    "checkpointed_training_step": "training, blocks recomputed",
    "least_memory_training_step": "training, objects recomputed",
}


def swept_rows(path: Path) -> list[Row]:
    """The rows of the sweep over triangles. Raises UserError naming the file."""
    rows = [row for row in read_rows(path) if row["sweep"] == SWEEP]
    if not rows:
        raise UserError(f"{path}: has no sweep '{SWEEP}': measure it with benchmark.only=[{SWEEP}] or all sweeps")
    return rows


def curve(rows: Sequence[Row], network: str, quantity: str, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Triangles in order, and values; what could not be measured is NaN."""
    points = sorted(
        (int(row["triangles"]), float(row[column] or "nan"))
        for row in rows
        if (row["network"], row["quantity"]) == (network, quantity)
    )
    triangles, values = np.array(points, float).reshape(-1, 2).T
    return triangles, values


def exponent(triangles: np.ndarray, seconds: np.ndarray) -> float | None:
    """p of the time c · triangles ** p that fits best within FITTED; None where fewer than two points are there."""
    there = np.isfinite(seconds) & (triangles >= FITTED[0]) & (triangles <= FITTED[1])
    if there.sum() < 2:
        return None
    return float(np.polyfit(np.log(triangles[there]), np.log(seconds[there]), 1)[0])


def exponents(rows: Sequence[Row]) -> dict[str, float | None]:
    """Network → exponent of its view-independent stage."""
    return {name: exponent(*curve(rows, name, "encode", "seconds")) for name in _networks(rows)}


def figure(rows: Sequence[Row]) -> Figure:
    """Every network over triangles, on logarithmic axes."""
    made, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained", sharex=True)
    fitted = exponents(rows)
    for axis, (title, (unit, column, lines)) in zip(axes.flat, _PANELS.items(), strict=True):
        for name, colour in zip(fitted, _COLOURS, strict=False):
            for quantity, line in lines.items():
                _draw(axis, *curve(rows, name, quantity, column), line, colour)
        axis.set(title=title, ylabel=unit, xscale="log", yscale="log")
        axis.grid(which="both", alpha=0.2)
        handles = _legend(fitted, lines, exponent_too="encode" in lines)
        if len(lines) > 2:  # many curves leave the legend no room
            axis.set_ylim(bottom=axis.get_ylim()[0] / 4)
            axis.legend(handles=handles, fontsize="small", loc="lower right", ncols=2)
        else:
            axis.legend(handles=handles, fontsize="small")
    measured = sorted({int(row["triangles"]) for row in rows})
    for axis in axes[1]:  # shared with those above
        axis.set_xlabel("triangles")
        axis.set_xticks(measured, [f"{n / 1000:g}K" for n in measured])
        axis.xaxis.minorticks_off()
    about = {key: rows[0].get(key, "") for key in ("hardware", "precision", "objects", "resolution", "commit")}
    made.suptitle("{hardware}, {precision}, {objects} objects, {resolution}², commit {commit}".format(**about))
    return made


def _draw(axis: Axes, triangles: np.ndarray, values: np.ndarray, line: str, colour: str) -> None:
    axis.plot(triangles, values, line, color=colour, marker="o", markersize=4)
    missing = triangles[np.isnan(values)]
    if line != ":":  # of rendering it is seen in its own panel
        axis.plot(missing, np.full(len(missing), 0.97), "x", color=colour, transform=axis.get_xaxis_transform())


def _legend(fitted: dict[str, float | None], lines: dict[str, str], exponent_too: bool) -> list[Line2D]:
    handles = []
    for (name, power), colour in zip(fitted.items(), _COLOURS, strict=False):
        label = f"{name} ∝ triangles^{power:.2f}" if exponent_too and power is not None else name
        handles.append(Line2D([], [], color=colour, marker="o", markersize=4, label=label))
    if len(lines) > 1:
        handles += [
            Line2D([], [], color="grey", linestyle=style, label=_NAMES.get(quantity, quantity))
            for quantity, style in lines.items()
        ]
    return [*handles, Line2D([], [], color="grey", linestyle="", marker="x", label="out of memory or time")]


def _networks(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row["network"] for row in rows))


def plot(path: Path) -> Path:
    """Prints the exponents and writes the plot beside the table. Raises UserError naming the file."""
    rows = swept_rows(path)
    for name, power in exponents(rows).items():
        shown = "too few points" if power is None else f"triangles^{power:.2f}"
        print(f"{name}: view-independent stage from {FITTED[0]:,} to {FITTED[1]:,} triangles: {shown}")
    return plotting.saved(figure(rows), path)


def main(arguments: Sequence[str] | None = None) -> Path:
    """See `plotting.command`."""
    return plotting.command("cost", __doc__, plot, arguments)


if __name__ == "__main__":
    main()

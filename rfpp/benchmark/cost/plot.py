"""Plot cost over triangles from the table of the benchmark.

python -m rfpp.benchmark.cost.plot data/results/cost.csv
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from rfpp.benchmark import plotting
from rfpp.benchmark.cost.measuring import COLUMNS
from rfpp.benchmark.csv_rows import command, read_rows
from rfpp.errors import UserError

#: Case of the plotted rows, which differ in the number of triangles.
CASE = {"objects": "50", "views": "1", "resolution": "256", "scenes": "1", "compiled": "false"}
#: Range of triangles in which the exponent is fitted.
FITTED = (10_000, 80_000)

_COLORS = ("tab:red", "tab:blue")
#: Panel → unit, column, and line style of each quantity.
_PANELS = {
    "View-independent stage": ("s", "seconds", {"encode": "-"}),
    "Rendering a view": ("s", "seconds", {"render": "-"}),
    "Training step": ("s", "seconds", {"training_step": "-", "checkpointed_training_step": "--"}),
    "Peak memory": (
        "GB", "peak_GB",
        {"render": ":", "training_step": "-", "checkpointed_training_step": "--", "least_memory_training_step": "-."},
    ),
}  # fmt: skip
_LABELS = {
    "encode": "encoding",
    "render": "rendering",
    "training_step": "training",
    "checkpointed_training_step": "training, blocks recomputed",
    "least_memory_training_step": "training, least memory",
}

Rows = Sequence[dict[str, str]]


def swept_rows(path: Path) -> Rows:
    """Return the rows over triangles. Raises UserError naming the file."""
    rows = [row for row in read_rows(path, "cost", COLUMNS) if CASE.items() <= row.items()]
    if not rows:
        raise UserError(f"{path}: no row with {CASE}: measure other triangles with benchmark.groups")
    return rows


def curve(rows: Rows, network: str, quantity: str, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return sorted triangles and their values; NaN where the network failed."""
    found = [row for row in rows if (row["network"], row["quantity"]) == (network, quantity)]
    points = sorted((int(row["triangles"]), float(row[column] or "nan")) for row in found)
    triangles, values = np.array(points, float).reshape(-1, 2).T
    return triangles, values


def exponents(rows: Rows) -> dict[str, float | None]:
    """Fit p of c · triangles ** p to each network's view-independent stage; None with fewer than two points."""
    fitted = {}
    for name in dict.fromkeys(row["network"] for row in rows):
        triangles, seconds = curve(rows, name, "encode", "seconds")
        used = np.isfinite(seconds) & (triangles >= FITTED[0]) & (triangles <= FITTED[1])
        logs = np.log(triangles[used]), np.log(seconds[used])
        fitted[name] = float(np.polyfit(*logs, 1)[0]) if used.sum() > 1 else None
    return fitted


def figure(rows: Rows) -> Figure:
    """Draw every network over triangles, on logarithmic axes; crosses are failures."""
    drawn, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained", sharex=True)
    networks = list(dict.fromkeys(row["network"] for row in rows))
    for axis, (title, (unit, column, lines)) in zip(axes.flat, _PANELS.items(), strict=True):
        for name, color in zip(networks, _COLORS, strict=False):
            for quantity, style in lines.items():
                triangles, values = curve(rows, name, quantity, column)
                label = f"{name}, {_LABELS[quantity]}"
                axis.plot(triangles, values, style, color=color, marker="o", markersize=4, label=label)
                failed = triangles[np.isnan(values)]
                height = np.full(len(failed), 0.97)
                axis.plot(failed, height, "x", color=color, transform=axis.get_xaxis_transform())
        axis.set(title=title, ylabel=unit, xscale="log", yscale="log")
        axis.grid(which="both", alpha=0.2)
        if len(lines) > 2:  # room for the legend
            axis.set_ylim(bottom=axis.get_ylim()[0] / 4)
        axis.legend(fontsize="x-small", ncols=1 + (len(lines) > 2))
    measured = sorted({int(row["triangles"]) for row in rows})
    for axis in axes[1]:  # shares its ticks with the axis above
        axis.set_xlabel("triangles")
        axis.set_xticks(measured, [f"{n / 1000:g}K" for n in measured])
        axis.xaxis.minorticks_off()
    about = {key: rows[0].get(key, "") for key in ("hardware", "precision", "objects", "resolution", "commit")}
    text = "{hardware}, {precision}, {objects} objects, {resolution}², commit {commit}; ×: out of memory or time"
    drawn.suptitle(text.format(**about))
    return drawn


def plot(path: Path) -> Path:
    """Print the exponents and save the plot beside the table. Raises UserError naming the file."""
    rows = swept_rows(path)
    for name, power in exponents(rows).items():
        fit = "too few points" if power is None else f"triangles^{power:.2f}"
        print(f"{name}: view-independent stage from {FITTED[0]:,} to {FITTED[1]:,} triangles: {fit}")
    return plotting.save(figure(rows), path)


def main(arguments: Sequence[str] | None = None) -> Path:
    """Run the command of the module's docstring."""
    return command("cost", __doc__, plot, arguments)


if __name__ == "__main__":
    main()

"""Error of refined images over minutes of training, from the CSV file of the benchmark.

python -m rfpp.benchmark.refining_plot data/results/refining.csv     writes a picture beside it
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt

from rfpp.benchmark import plotting
from rfpp.errors import UserError


def plot(file: Path) -> Path:
    """A line for each number of training scenes, and the error without refinement; returns the PNG.

    Raises UserError: the file cannot be read, or is not of this benchmark.
    """
    try:
        rows = list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))
        lines = {
            int(row["scenes"]): [
                (float(at["minutes"]), float(at["log_l1"])) for at in rows if at["scenes"] == row["scenes"]
            ]
            for row in rows
        }
        unrefined = float(rows[0]["unrefined_log_l1"])
    except (OSError, IndexError, KeyError, ValueError) as error:
        raise UserError(f"{file}: not a table of benchmark=refining ({error}): measure it first") from None
    figure, axes = plt.subplots(figsize=(6, 4), constrained_layout=True)
    axes.axhline(unrefined, color="grey", linestyle=":", label="not refined")
    for scenes, points in lines.items():
        axes.plot(*zip(*points, strict=True), ".-", label=f"{scenes} scenes")
    axes.set(xlabel="minutes of training", ylabel="log-L1 of validation images")
    axes.set_ylim(top=1.02 * unrefined)
    axes.grid(alpha=0.2)
    axes.legend()
    return plotting.saved(figure, file)


def main(arguments: Sequence[str] | None = None) -> Path:
    """See `plotting.command`."""
    return plotting.command("refining", __doc__, plot, arguments)


if __name__ == "__main__":
    main()

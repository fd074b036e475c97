"""Error of refined images over minutes of training, from the CSV file of the benchmark.

python -m rfpp.benchmark.refining_plot data/results/refining.csv     writes a picture beside it
"""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only: no window system is needed

import matplotlib.pyplot as plt

from rfpp.errors import UserError
from rfpp.files import write_atomically


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
    stream = io.BytesIO()
    figure.savefig(stream, dpi=110)
    plt.close(figure)
    return write_atomically(file.with_suffix(".png"), stream.getvalue())


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; `arguments` are those of the command line unless given."""
    parser = argparse.ArgumentParser("python -m rfpp.benchmark.refining_plot", description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="CSV of launch/benchmark.py benchmark=refining")
    try:
        print(plot(parser.parse_args(arguments).file))
    except UserError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()

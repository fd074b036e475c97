"""What the plots of benchmarks share: their command, and the picture beside its table."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only: no window system is needed

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from rfpp.errors import UserError
from rfpp.files import write_atomically


def saved(figure: Figure, table: Path) -> Path:
    """Writes a PNG beside the table, under its name, and returns its path; the figure is closed."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    plt.close(figure)
    return write_atomically(table.with_suffix(".png"), stream.getvalue())


def command(
    benchmark: str, description: str | None, plot: Callable[[Path], Path], arguments: Sequence[str] | None
) -> Path:
    """The command of a plot: a benchmark's table in, a picture out, errors in one line.

    Args:
        benchmark: the name of its table, in the help.
        description: what the help says, the module's docstring.
        plot: table → picture.
        arguments: those of the command line unless given.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, help=f"what launch/benchmark.py benchmark={benchmark} has written")
    table = parser.parse_args(arguments).csv
    try:
        picture = plot(table)
    except UserError as error:
        parser.exit(1, f"error: {error}\n")
    print(picture)
    return picture

"""Save the plots of benchmarks beside their tables."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # writes files without a window system

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from rfpp.files import write_atomically


def save(figure: Figure, table: Path) -> Path:
    """Write a PNG beside the table, close the figure and return the PNG's path."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    plt.close(figure)
    return write_atomically(table.with_suffix(".png"), stream.getvalue())

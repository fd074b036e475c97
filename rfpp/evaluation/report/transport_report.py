"""The report on a transport operator: CSV, plot, image sheet and HTML page."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.evaluation.measuring.transport_convergence import TransportTrace
from rfpp.evaluation.report.page import page
from rfpp.files import write_atomically
from rfpp.imaging.panels import error_map, panel, save_picture, tone_mapped

_CURVES = {
    "residual": "consistency residual\nmean |F_s − T(F_s + F_e)|²",
    "change": "image change by one more\nlog-L1",
    "error": "image error\nlog-L1",
}


def write_transport_report(trace: TransportTrace, info: CheckpointInfo, title: str, folder: Path) -> list[Path]:
    """Write `transport.csv`, `curves.png`, `images.png` and `index.html` into a folder; returns their paths.

    Raises:
        UserError: a file cannot be written.
    """
    pictures = {
        "curves.png": "How far each state is from the next, how much the decoded image still changes, and how far it "
        "is from the path-traced one. Line: median over scenes; band: 10th to 90th percentile.",
        "images.png": "Images decoded after k applications, and below each its error.",
    }
    files = [_write_csv(trace, folder), _write_curves(trace, folder / "curves.png"), _write_images(trace, folder)]
    about = f"{info.method}, seed {info.seed}, {info.steps} steps on {info.dataset}, trained with K = {trace.trained}"
    content = page("transport.html", title=title, about=about, pictures=pictures)
    return [*files, write_atomically(folder / "index.html", content)]


def _write_csv(trace: TransportTrace, folder: Path) -> Path:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["k", *(f"{name}_{what}" for name in _CURVES for what in ("p10", "median", "p90"))])
    columns = [np.percentile(getattr(trace, name), (10, 50, 90), axis=1) for name in _CURVES]
    writer.writerows([k, *(f"{v:.6g}" for v in row)] for k, row in enumerate(np.concatenate(columns).T))
    return write_atomically(folder / "transport.csv", stream.getvalue().encode())


def _write_curves(trace: TransportTrace, path: Path) -> Path:
    figure = _figure(trace)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    plt.close(figure)
    return write_atomically(path, stream.getvalue())


def _figure(trace: TransportTrace) -> Figure:
    figure, axes = plt.subplots(1, len(_CURVES), figsize=(12, 3.6), layout="constrained")
    for axis, (name, label) in zip(axes, _CURVES.items(), strict=True):
        low, median, high = np.percentile(getattr(trace, name), (10, 50, 90), axis=1)
        k = np.arange(len(median))
        axis.fill_between(k, low, high, alpha=0.2)
        axis.plot(k, median, marker="o")
        axis.axvline(trace.trained, color="grey", linestyle=":", label=f"trained K = {trace.trained}")
        axis.set(xlabel="applications k", title=label)
        if name != "error":
            axis.set_yscale("log")
    axes[0].legend()
    return figure


def _write_images(trace: TransportTrace, folder: Path) -> Path:
    columns = {f"k = {k}": [] for k in range(len(trace.radiance))} | {"reference": []}
    for row, reference in enumerate(trace.reference):
        for k, images in enumerate(trace.radiance):
            columns[f"k = {k}"] += [tone_mapped(images[row]), error_map(images[row], reference)]
        columns["reference"] += [tone_mapped(reference), np.full_like(tone_mapped(reference), 255)]
    return save_picture(panel(columns), folder / "images.png")

"""Scatter plots as inline SVG, with selectable text and colours of the page's style sheet."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

#: Placeholder colours → colours of the page.
_INK, _ACCENT, _MUTED = "#010203", "#010204", "#010205"
_COLOURS = {_INK: "currentColor", _ACCENT: "var(--accent)", _MUTED: "var(--muted)"}

_SIZE = (3.6, 1.7)  # inches
_STYLE = {
    "svg.fonttype": "none", "font.size": 8, "axes.spines.top": False, "axes.spines.right": False,
    "text.color": _INK, "axes.edgecolor": _MUTED, "axes.labelcolor": _INK, "xtick.color": _MUTED, "ytick.color": _MUTED,
    "xtick.labelcolor": _INK, "ytick.labelcolor": _INK, "axes.formatter.useoffset": False,
}  # fmt: skip
_LOG_FROM = 20  # ratio of largest to smallest number from which an axis is logarithmic
_MAX_MARKS = 1000  # more points are rasterized, which keeps the page small


def size_plot(triangles: Sequence[int], values: Sequence[float], may_be_log: bool) -> Markup:
    """Plot one point per scene over its number of triangles. Non-finite values are omitted.

    Args:
        triangles: Number of triangles of each scene.
        values: Value of each scene.
        may_be_log: Whether values of different magnitude get a logarithmic axis.
    """
    with rc_context({**_STYLE, "svg.hashsalt": repr(values)}):
        figure = Figure(figsize=_SIZE, dpi=150, layout="constrained")
        axes = figure.subplots()
        finite = np.isfinite(values)
        x, y = np.asarray(triangles)[finite], np.asarray(values)[finite]
        axes.scatter(x, y, s=10, color=_ACCENT, alpha=0.6, linewidths=0, rasterized=len(x) > _MAX_MARKS)
        axes.set(xlabel="triangles")
        _scale(axes, "x", x)
        if may_be_log:
            _scale(axes, "y", y)
        return _svg(figure)


def _scale(axes: Axes, which: str, numbers: np.ndarray) -> None:
    """Make an axis logarithmic if its values span orders of magnitude."""
    if len(numbers) and numbers.min() > 0 and numbers.max() > _LOG_FROM * numbers.min():
        axes.set(**{f"{which}scale": "log"})
        axis = getattr(axes, f"{which}axis")
        axis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_locator(NullLocator())


def _svg(figure: Figure) -> Markup:
    stream = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(stream, format="svg", metadata=metadata, transparent=True)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    # inline SVG needs no name spaces; styles and ids would apply to the whole page
    text = re.sub(r' xmlns(:xlink)?="[^"]*"|<style.*?</style>|(?<=<g) id="[^"]*"|font-family: [^;]*; ?', "", text)
    for placeholder, colour in _COLOURS.items():
        text = text.replace(placeholder, colour)
    return Markup(re.sub(r"\s*\n\s*", " ", text))

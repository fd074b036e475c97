"""Inline SVG plots with selectable text and colours from the page's style sheet."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from rfpp.evaluation.measuring.records import MODEL

#: Colours that matplotlib is given → what the page makes of them.
_INK, _ACCENT, _MUTED = "#010203", "#010204", "#010205"
_COLOURS = {_INK: "currentColor", _ACCENT: "var(--accent)", _MUTED: "var(--muted)"}

_SIZE = (3.6, 1.7)  # inches
_STYLE = {
    "svg.fonttype": "none", "font.size": 8, "axes.spines.top": False, "axes.spines.right": False,
    "text.color": _INK, "axes.edgecolor": _MUTED, "axes.labelcolor": _INK, "xtick.color": _MUTED, "ytick.color": _MUTED,
    "xtick.labelcolor": _INK, "ytick.labelcolor": _INK, "axes.formatter.useoffset": False,
}  # fmt: skip
_LOG_FROM = 20  # largest over smallest number from which an axis is logarithmic
_MAX_MARKS = 1000  # more points than these are drawn as one picture, which keeps the page small
_PERCENTILES = (5, 25, 50, 75, 95)


def distribution_plot(values: Mapping[str, Sequence[float]], may_be_log: bool) -> Markup:
    """A line per predictor: 5th to 95th percentile of its scenes thin, 25th to 75th thick, the median a dot.

    Args:
        values: one number per scene, by predictor, from top to bottom; those that are not finite are left out.
        may_be_log: whether numbers far apart are drawn on a logarithmic axis, as suits errors.
    """
    with rc_context({**_STYLE, "svg.hashsalt": repr(values)}):
        figure, axes = _axes()
        shown = {name: np.asarray(numbers)[np.isfinite(numbers)] for name, numbers in values.items()}
        for row, (name, numbers) in enumerate(shown.items()):
            if len(numbers):
                low, first, median, third, high = np.percentile(numbers, _PERCENTILES)
                colour = _ACCENT if name == MODEL else _MUTED
                axes.hlines([row, row], [low, first], [high, third], colour, linewidths=[1, 5])
                axes.plot(median, row, "o", color=_INK, markersize=3.5)
        axes.set_yticks(range(len(values)), list(values), parse_math=False)
        axes.set_ylim(len(values) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)
        if may_be_log:
            _spread(axes, "x", np.concatenate([*shown.values()]))
        return _svg(figure)


def size_plot(triangles: Sequence[int], values: Sequence[float], may_be_log: bool) -> Markup:
    """One point per scene over its number of triangles; non-finite values are omitted.

    Args:
        may_be_log: as for `distribution_plot`.
    """
    with rc_context({**_STYLE, "svg.hashsalt": repr(values)}):
        figure, axes = _axes()
        finite = np.isfinite(values)
        x, y = np.asarray(triangles)[finite], np.asarray(values)[finite]
        axes.scatter(x, y, s=10, color=_ACCENT, alpha=0.6, linewidths=0, rasterized=len(x) > _MAX_MARKS)
        axes.set(xlabel="triangles")
        _spread(axes, "x", x)
        if may_be_log:
            _spread(axes, "y", y)
        return _svg(figure)


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, dpi=150, layout="constrained")
    return figure, figure.subplots()


def _spread(axes: Axes, which: str, numbers: np.ndarray) -> None:
    """Make an axis logarithmic if its values span orders of magnitude."""
    if len(numbers) and numbers.min() > 0 and numbers.max() > _LOG_FROM * numbers.min():
        axes.set(**{f"{which}scale": "log"})
        axis = getattr(axes, f"{which}axis")
        axis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_locator(NullLocator())


def _svg(figure: Figure) -> Markup:
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(stream, format="svg", metadata=nothing, transparent=True)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    # what a file needs and a page does not: name spaces, a style for everything, names that each plot has
    text = re.sub(r' xmlns(:xlink)?="[^"]*"|<style.*?</style>|(?<=<g) id="[^"]*"|font-family: [^;]*; ?', "", text)
    for drawn, shown in _COLOURS.items():
        text = text.replace(drawn, shown)
    return Markup(re.sub(r"\s*\n\s*", " ", text))

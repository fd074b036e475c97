"""Summarise light-transport measurements over seeds, as Markdown and as a plot.

python -m rfpp.evaluation.tables.light_summary data/results/light.csv     writes light.md and light.png beside it
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rfpp.evaluation.tables.light_table import light_rows
from rfpp.files import write_atomically

Row = Mapping[str, str]
#: Of a network made useless in part, and the heading of each.
_GROWTH = {
    "log_l1_growth_exchanged_tokens": "other scenes' tokens",
    "log_l1_growth_permuted_light": "light dealt anew",
    "log_l1_growth_no_transport": "no transport",
}


@dataclass(frozen=True)
class Method:
    """The seeds of one method on one data set.

    Attributes:
        label: its name and, where it was trained, for how long on what.
        rows: one of each seed.
    """

    label: str
    rows: Sequence[Row]

    @property
    def trained(self) -> bool:
        return bool(self.rows[0]["steps"])

    def values(self, column: str) -> np.ndarray:
        """[seeds]; empty where it was not measured."""
        return np.array([float(row[column]) for row in self.rows if row.get(column)])

    def text(self, column: str, digits: int) -> str:
        """Mean ± standard deviation over seeds."""
        values = self.values(column)
        spread = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
        return f"{values.mean():.{digits}f}{spread}" if len(values) else ""


def methods(rows: Sequence[Row]) -> dict[tuple[str, str], list[Method]]:
    """Methods by data set and bounces, best first."""
    grouped: dict[tuple[str, str], dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        trained = f", {row['steps']} steps on {row['trained_on']}" if row["steps"] else ""
        grouped[row["data"], row["bounces"]][row["method"] + trained].append(row)
    return {
        key: sorted(
            (Method(label, of_seeds) for label, of_seeds in by_label.items()),
            key=lambda method: method.values("further_light").mean(),
        )
        for key, by_label in sorted(grouped.items())
    }


def markdown(rows: Sequence[Row]) -> str:
    """A table for each data set."""
    headings = ["", "seeds", "further light, rel. L1", "95% over scenes", "median scene", "energy", "log-L1"]
    headings += [f"log-L1: {heading}" for heading in _GROWTH.values()]
    text = []
    for (data, bounces), found in methods(rows).items():
        title = f"## {data}" + (f", light that ends after {bounces} bounces" if bounces else "")
        text += [title, "", f"| {' | '.join(headings)} |", f"|---|{'---:|' * (len(headings) - 1)}"]
        text += [f"| {' | '.join(_cells(method))} |" for method in found] + [""]
    return "\n".join(text)


def _cells(method: Method) -> list[str]:
    low, high = (method.values(f"further_light_{end}").mean() for end in ("low", "high"))
    growth = [method.values(column) for column in _GROWTH]
    return [
        method.label if method.trained else f"*{method.label}*",
        str(len(method.rows)) if method.trained else "",
        method.text("further_light", 3),
        f"{low:.3f}–{high:.3f}",
        method.text("further_light_median", 3),
        method.text("further_energy", 2),
        method.text("log_l1", 5),
        *(f"{values.mean():+.1%}" if len(values) else "" for values in growth),
    ]


def png(found: Sequence[Method]) -> bytes:
    """Plot of one data set: one dot per seed, bars are 95% intervals over scenes."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    from rfpp.evaluation.tables.dot_plot import png as as_png

    made = Figure(figsize=(11, 0.9 + 0.26 * len(found)), dpi=120, layout="constrained")
    panels = made.subplots(1, 2, sharey=True)
    columns = {"further_light": "further light, relative L1", "log_l1": "log-L1"}
    for axes, (column, heading) in zip(panels, columns.items(), strict=True):
        for height, method in enumerate(found):
            colour = "tab:blue" if method.trained else "0.6"
            values = method.values(column)
            axes.plot(values, [height] * len(values), "o", color=colour, markersize=4)
            if column == "further_light":
                ends = (method.values(f"{column}_{end}").mean() for end in ("low", "high"))
                axes.hlines(height, *ends, colour, linewidth=3, alpha=0.3)
        axes.set(xlabel=heading, xscale="log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(axis="x", which="both", alpha=0.3)
    panels[0].set_yticks(range(len(found)), [method.label for method in found])
    panels[0].set_ylim(len(found) - 0.5, -0.5)
    return as_png(made)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; the picture is of the data set with the most methods."""
    [name] = sys.argv[1:] if arguments is None else arguments
    rows = light_rows(Path(name))
    write_atomically(Path(name).with_suffix(".md"), markdown(rows).encode())
    write_atomically(Path(name).with_suffix(".png"), png(max(methods(rows).values(), key=len)))


if __name__ == "__main__":
    main()

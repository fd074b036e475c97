"""A table of results as Markdown, LaTeX and CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from rfpp.evaluation.measuring.csv_files import Row as CsvRow
from rfpp.evaluation.measuring.csv_files import write_rows
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.tables.layout import Layout, lay_out
from rfpp.evaluation.tables.rows import ResultTable, Row, Run
from rfpp.files import write_atomically
from rfpp.metrics.image import METRICS

_MARKDOWN = str.maketrans({character: f"\\{character}" for character in "\\*_|<[]"})
_LATEX = str.maketrans(
    {
        **{character: f"\\{character}" for character in "&%$#_{}"},
        "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
        "|": r"\textbar{}", "<": r"\textless{}", ">": r"\textgreater{}",
        "↓": r"$\downarrow$", "↑": r"$\uparrow$", "≥": r"$\geq$", "±": r"$\pm$", "–": "--", "—": "---",
    }
)  # fmt: skip


def write_table(table: ResultTable, folder: Path) -> list[Path]:
    """`<name>.md`, `<name>.tex` and `<name>.csv` in `folder`; returns their paths.

    Raises:
        UserError: a file cannot be written.
    """
    layout = lay_out(table)
    texts = {"md": markdown(layout), "tex": latex(layout)}
    files = [write_atomically(folder / f"{table.name}.{end}", text.encode()) for end, text in texts.items()]
    return [*files, write_rows(folder / f"{table.name}.csv", list(csv_rows(table)))]


def markdown(layout: Layout) -> str:
    """GitHub Markdown; tables have one header line, so group headings are repeated in each column."""
    spanned = [group for group, count in layout.groups.items() for _ in range(count)]
    headings = [*layout.headings[:2], *(f"{g}: {h}" for g, h in zip(spanned, layout.headings[2:], strict=True))]
    rows = [headings]
    for heading, lines in layout.blocks:
        rows.append([f"**{heading}**", *[""] * (len(headings) - 1)])
        rows += [[cell.translate(_MARKDOWN) for cell in line] for line in lines]
    table = [f"| {' | '.join(row)} |" for row in rows]
    table.insert(1, f"|{'---|' * 2}{'---:|' * len(spanned)}")
    notes = [f"- {note.translate(_MARKDOWN)}" for note in layout.notes]
    return "\n".join([f"## {layout.title}", "", *table, "", *notes, ""])


def latex(layout: Layout) -> str:
    """For \\input in a paper; needs the packages booktabs and graphicx."""
    width = len(layout.headings)
    spans = [rf"\multicolumn{{{count}}}{{c}}{{{_escaped(group)}}}" for group, count in layout.groups.items()]
    body = [_latex_line(["", "", *spans]), _latex_line([_escaped(heading) for heading in layout.headings])]
    for heading, lines in layout.blocks:
        body += [r"\midrule", rf"\multicolumn{{{width}}}{{l}}{{\textit{{{_escaped(heading)}}}}} \\"]
        body += [_latex_line([_escaped(cell) for cell in line]) for line in lines]
    return "\n".join(
        [
            r"\begin{table*}[t]", r"\centering", rf"\caption{{{_escaped(layout.title)}}}",
            r"\resizebox{\textwidth}{!}{%", rf"\begin{{tabular}}{{ll{'r' * (width - 2)}}}", r"\toprule",
            *body,
            r"\bottomrule", r"\end{tabular}}", r"\par\smallskip\footnotesize\raggedright",
            *(rf"{_escaped(note)}\par" for note in layout.notes),
            r"\end{table*}", "",
        ]
    )  # fmt: skip


def csv_rows(table: ResultTable) -> Iterator[CsvRow]:
    """One row per number (long format); `ours` is empty for methods that were not run."""
    for heading, rows in table.blocks:
        for row in rows:
            for run in row.runs or [None]:
                for index, group in enumerate(table.groups):
                    for metric in table.metrics:
                        paper = row.paper[index][metric] if row.paper else None
                        where = {"block": heading, "method": row.label, "columns": group, "metric": metric}
                        definition = {"definition": METRICS[metric].definition}
                        yield {**where, "paper": paper, **_ours(run, index, metric), **_about(row, run), **definition}


def _ours(run: Run | None, index: int, metric: str) -> CsvRow:
    column = run.columns[index] if run else None
    estimate = column.means.get(metric) if column else None
    numbers = asdict(estimate) if estimate else dict.fromkeys(("mean", "low", "high", "scenes"))
    deviation = column.deviations.get(metric) if column else None
    return {"ours": numbers.pop("mean"), **numbers, "sd_of_seeds": deviation}


def _about(row: Row, run: Run | None) -> CsvRow:
    """The source of our numbers; baselines are not trained."""
    evaluations = run.evaluations if run else []
    trained = [] if row.is_baseline else evaluations
    return {
        "trained_on": _joined(trained, lambda e: e.trained_on),
        "steps": _joined(trained, lambda e: e.steps),
        "paper_steps": row.paper_steps,
        "seeds": _joined(trained, lambda e: e.seed),
        "step_s": _joined(trained, lambda e: e.cost and f"{e.cost.seconds:.4g}"),
        "memory_GiB": _joined(trained, lambda e: e.cost and f"{e.cost.memory:.4g}"),
        "commit": _joined(trained, lambda e: e.commit),
        "evaluated_on": _joined(evaluations, lambda e: e.data),
        "manifests": _joined(evaluations, lambda e: e.data_manifest),
        "hardware": _joined(evaluations, lambda e: e.hardware),
    }


def _joined(evaluations: Sequence[Evaluation], of: Callable[[Evaluation], object]) -> str | None:
    values = dict.fromkeys(of(e) for e in evaluations)
    return "; ".join(str(value) for value in values if value is not None) or None


def _latex_line(cells: Sequence[str]) -> str:
    return f"{' & '.join(cells)} \\\\"


def _escaped(text: str) -> str:
    return text.translate(_LATEX)

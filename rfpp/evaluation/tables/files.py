"""Write a table of results as Markdown, LaTeX and CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from rfpp.evaluation.measuring.csv_files import Row as CsvRow
from rfpp.evaluation.measuring.csv_files import write_rows
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.number_text import EMPTY, ablation_text, interval_text, number_text
from rfpp.evaluation.tables.rows import ResultTable, Row, Run
from rfpp.files import write_atomically
from rfpp.metrics.image import METRICS

_ESCAPED = str.maketrans({character: f"\\{character}" for character in "\\*_|<[]"})
_LATEX = str.maketrans(
    {
        **{character: f"\\{character}" for character in "&%$#_{}"}, "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}", "<": r"\textless{}",
        ">": r"\textgreater{}", "↓": r"$\downarrow$", "↑": r"$\uparrow$", "≥": r"$\geq$", "±": r"$\pm$", "–": "--",
    }
)  # fmt: skip
_NOTES = (
    "95% interval: percentile bootstrap over scenes. A mean over splits or data sets gives each the same weight, and "
    "joins intervals in quadrature. Intervals are averaged over seeds, which share their scenes. sd: standard "
    "deviation of the seeds' means.",
    "x: prediction, y: reference, I: either of them. Metrics are means over the views of a scene, then over scenes.",
)


def write_table(table: ResultTable, folder: Path) -> list[Path]:
    """Write `<name>.md`, `<name>.tex` and `<name>.csv` into `folder`; return their paths."""
    texts = {"md": markdown(table), "tex": latex(table)}
    written = [write_atomically(folder / f"{table.name}.{end}", text.encode()) for end, text in texts.items()]
    return [*written, write_rows(folder / f"{table.name}.csv", list(csv_rows(table)))]


def markdown(table: ResultTable) -> str:
    """Format a table as GitHub Markdown: the paper's numbers, ours, their intervals and their spread over seeds."""
    headings, blocks, notes = _cells(table)
    lines = [["Method", "", *headings]]
    for heading, rows in blocks:
        lines.append([f"**{heading}**", *[""] * (len(headings) + 1)])
        lines += [[cell.translate(_ESCAPED) for cell in row] for row in rows]
    text = [f"| {' | '.join(line)} |" for line in lines]
    text.insert(1, f"|{'---|' * 2}{'---:|' * len(headings)}")
    return "\n".join([f"## {table.title}", "", *text, "", *(f"- {note.translate(_ESCAPED)}" for note in notes), ""])


def latex(table: ResultTable) -> str:
    r"""Format a table for \input in a paper; it needs the packages booktabs and graphicx."""
    headings, blocks, notes = _cells(table)

    def line(cells: Sequence[str]) -> str:
        return f"{' & '.join(cell.translate(_LATEX) for cell in cells)} \\\\"

    body = [line(["Method", "", *headings])]
    for heading, rows in blocks:
        title = rf"\multicolumn{{{len(headings) + 2}}}{{l}}{{\textit{{{heading.translate(_LATEX)}}}}} \\"
        body += [r"\midrule", title, *map(line, rows)]
    begin = [r"\begin{table*}[t]", r"\centering", rf"\caption{{{table.title.translate(_LATEX)}}}"]
    columns = rf"\resizebox{{\textwidth}}{{!}}{{\begin{{tabular}}{{ll{'r' * len(headings)}}}"
    end = [r"\bottomrule", r"\end{tabular}}", r"\par\smallskip\footnotesize\raggedright"]
    texts = [rf"{note.translate(_LATEX)}\par" for note in notes]
    return "\n".join([*begin, columns, r"\toprule", *body, *end, *texts, r"\end{table*}", ""])


def _cells(table: ResultTable) -> tuple[list[str], list[tuple[str, list[list[str]]]], list[str]]:
    """Return the headings of the numbers, the lines of each block, and the notes."""
    columns = [(group, name) for group in range(len(table.groups)) for name in table.metrics]
    headings = [f"{heading}: {METRICS[name].heading}" for heading in table.groups for name in table.metrics]
    notes: list[str] = []
    blocks = [
        (heading, [line for row in rows for line in _lines(row, columns, notes)]) for heading, rows in table.blocks
    ]
    definitions = (f"{METRICS[name].label}: {METRICS[name].definition}." for name in table.metrics)
    return headings, blocks, [*notes, *_NOTES, *definitions]


def csv_rows(table: ResultTable) -> Iterator[CsvRow]:
    """Return one row per number (long format); `ours` is empty for methods without a run."""
    for heading, rows in table.blocks:
        for row in rows:
            for run in row.runs or [None]:
                for index, group in enumerate(table.groups):
                    for metric in table.metrics:
                        where = {"block": heading, "method": row.label, "columns": group, "metric": metric}
                        paper = {"paper": row.paper[index][metric] if row.paper else None}
                        definition = {"definition": METRICS[metric].definition}
                        yield {**where, **paper, **_numbers(run, index, metric), **_source(row, run), **definition}


def _lines(row: Row, columns: Sequence[tuple[int, str]], notes: list[str]) -> Iterator[list[str]]:
    """Return the lines of one row; append a note per run to `notes`."""
    label = row.label
    if row.paper is not None:
        yield [label, "paper", *(number_text(name, row.paper[group][name]) for group, name in columns)]
        label = ""
    if not row.runs:
        yield [label, "ours: not run", *(EMPTY for _ in columns)]
    for run in row.runs:
        values = [(name, run.columns[group].means.get(name)) for group, name in columns]
        means = [EMPTY if value is None else number_text(name, value.mean) for name, value in values]
        if row.is_baseline:
            yield [label, "baseline", *means]
            continue
        notes.append(f"[{len(notes) + 1}] {_training_text(run)}, {_description(run)}")
        yield [label, f"ours [{len(notes)}]: {_training_text(run, row.paper_steps)}", *means]
        yield ["", "95% interval", *(interval_text(name, value) for name, value in values)]
        if len(run.seeds) > 1:
            spread = [(name, run.columns[group].deviations.get(name)) for group, name in columns]
            texts = (EMPTY if value is None else number_text(name, value) for name, value in spread)
            yield ["", f"sd of {len(run.seeds)} seeds", *texts]
        label = ""


def _training_text(run: Run, paper_steps: int | None = None) -> str:
    """Format a training, e.g. "27K of the paper's 500K steps on small_scale"."""
    steps, data = run.evaluations[0].steps, run.evaluations[0].trained_on
    if steps is None:
        return f"trained on {data}"
    fraction = f" of the paper's {_thousands(paper_steps)}" if paper_steps and steps < paper_steps else ""
    return f"{_thousands(steps)}{fraction} steps on {data}"


def _description(run: Run) -> str:
    """Format seeds, commit, data, hardware and, for the first seed, the ablations on the last split."""
    first = run.evaluations[0]
    data = []
    for e in {e.data: e for e in run.evaluations}.values():
        scenes = {split: next(iter(values.values())).scenes for (split, _), values in e.means.items()}
        counts = ", ".join(f"{split} {count} scenes" for split, count in scenes.items())
        data.append(f"{e.data} (manifest {e.data_manifest[:12]}; {counts})")
    growth = [growth for growth in first.ablation.values() if growth]
    ablation = f" Seed {first.seed}: {ablation_text(growth[-1])}." if growth else ""
    return (
        f"seed{'s' * (len(run.seeds) > 1)} {', '.join(map(str, run.seeds))}, commit {first.commit or 'unknown'}; "
        f"evaluated on {' and '.join(data)}, by {_joined(run.evaluations, lambda e: e.hardware)}.{ablation}"
    )


def _numbers(run: Run | None, index: int, metric: str) -> CsvRow:
    column = run.columns[index] if run else None
    estimate = column.means.get(metric) if column else None
    numbers = asdict(estimate) if estimate else dict.fromkeys(("mean", "low", "high", "scenes"))
    deviation = column.deviations.get(metric) if column else None
    return {"ours": numbers.pop("mean"), **numbers, "sd_of_seeds": deviation}


def _source(row: Row, run: Run | None) -> CsvRow:
    evaluations = run.evaluations if run else []
    trained = [] if row.is_baseline else evaluations
    return {
        "trained_on": _joined(trained, lambda e: e.trained_on),
        "steps": _joined(trained, lambda e: e.steps),
        "paper_steps": row.paper_steps,
        "seeds": _joined(trained, lambda e: e.seed),
        "commit": _joined(trained, lambda e: e.commit),
        "evaluated_on": _joined(evaluations, lambda e: e.data),
        "manifests": _joined(evaluations, lambda e: e.data_manifest),
        "hardware": _joined(evaluations, lambda e: e.hardware),
    }


def _joined(evaluations: Sequence[Evaluation], attribute: Callable[[Evaluation], object]) -> str | None:
    values = dict.fromkeys(attribute(e) for e in evaluations)
    return "; ".join(str(value) for value in values if value is not None) or None


def _thousands(count: int) -> str:
    return f"{count // 1000}K" if count and count % 1000 == 0 else str(count)

"""Build table rows from evaluations: join seeds, average splits and data sets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rfpp.evaluation.measuring.confidence import Estimates, mean_of_parts, mean_of_seeds
from rfpp.evaluation.measuring.evaluation_file import Evaluation
from rfpp.evaluation.measuring.records import MODEL
from rfpp.evaluation.tables.paper import PAPER_METRICS, PaperTable

#: Heading of a group of columns → splits that it averages.
Groups = Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Column:
    """One group of columns in one row."""

    means: Estimates
    deviations: Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """One training, or several that differ only in their seeds."""

    evaluations: Sequence[Evaluation]
    columns: Sequence[Column]

    @property
    def seeds(self) -> list[int]:
        """Seeds of the runs."""
        return sorted({evaluation.seed for evaluation in self.evaluations})


@dataclass(frozen=True)
class Row:
    """A method in a table.

    Attributes:
        runs: Our runs; empty if there are none.
        paper: The paper's numbers, by metric for each group of columns; None if the method is not in the paper.
        paper_steps: Optimizer steps in the paper, if known.
    """

    label: str
    runs: Sequence[Run]
    paper: Sequence[Mapping[str, float]] | None = None
    paper_steps: int | None = None
    is_baseline: bool = False


@dataclass(frozen=True)
class ResultTable:
    """A table of rows in named blocks."""

    name: str
    title: str
    groups: Groups
    metrics: Sequence[str]
    blocks: Sequence[tuple[str, Sequence[Row]]]

    def evaluations(self) -> list[Evaluation]:
        """Return the evaluations behind the rows, except for baselines."""
        rows = (row for _, rows in self.blocks for row in rows if not row.is_baseline)
        return [evaluation for row in rows for run in row.runs for evaluation in run.evaluations]


def paper_table(table: PaperTable, evaluations: Sequence[Evaluation]) -> ResultTable:
    """Put our numbers into a table of the paper. A run that lacks a data set or split of its row is omitted."""
    blocks = []
    for block in table.blocks:
        rows = []
        for row in block.rows:
            ours = [e for e in evaluations if e.method == row.method]
            runs = [run for run in _runs(ours, block.data, table.groups) if all(c.means for c in run.columns)]
            numbers = np.reshape(row.values, (len(table.groups), len(PAPER_METRICS))).tolist()
            paper = [dict(zip(PAPER_METRICS, group, strict=True)) for group in numbers]
            rows.append(Row(row.label, runs, paper, row.steps))
        blocks.append((block.heading, [*rows, *_baseline_rows(evaluations, block.data, table.groups)]))
    return ResultTable(table.name, table.title, table.groups, PAPER_METRICS, blocks)


def other_table(evaluations: Sequence[Evaluation]) -> ResultTable:
    """Put evaluations into a table with one block per data set."""
    groups = {split: (split,) for e in evaluations for split, _ in e.means}
    blocks = []
    for data in sorted({e.data for e in evaluations}):
        ours = [e for e in evaluations if e.data == data]
        methods = dict.fromkeys(e.method for e in ours)
        rows = [Row(method, _runs([e for e in ours if e.method == method], (data,), groups)) for method in methods]
        blocks.append((f"Data set '{data}'", [*rows, *_baseline_rows(ours, (data,), groups)]))
    metrics = list(dict.fromkeys(name for e in evaluations for name in e.definitions))
    return ResultTable("others", "Evaluations beyond the paper's tables", groups, metrics, blocks)


def _runs(evaluations: Sequence[Evaluation], data: Sequence[str], groups: Groups) -> list[Run]:
    """Group the evaluations of one method into runs; keep seeds that were evaluated on all data sets."""
    trainings: dict[tuple, dict[int, list[Evaluation]]] = defaultdict(lambda: defaultdict(list))
    for e in evaluations:
        if e.data in data:
            trainings[e.trained_on, e.steps, e.commit][e.seed].append(e)
    complete = ([s[seed] for seed in sorted(s) if len(s[seed]) == len(data)] for s in trainings.values())
    return [_run(seeds, MODEL, groups) for seeds in complete if seeds]


def _baseline_rows(evaluations: Sequence[Evaluation], data: Sequence[str], groups: Groups) -> list[Row]:
    """Return the rows of the baselines. They depend on the data alone, so any evaluation has their numbers."""
    by_data = {e.data: e for e in evaluations if e.data in data}
    if len(by_data) < len(data):
        return []
    names = dict.fromkeys(who for e in by_data.values() for _, who in e.means if who != MODEL)
    rows = [Row(name, [_run([list(by_data.values())], name, groups)], is_baseline=True) for name in names]
    return [row for row in rows if any(column.means for column in row.runs[0].columns)]


def _run(seeds: Sequence[Sequence[Evaluation]], predictor: str, groups: Groups) -> Run:
    """Average one predictor; `seeds` holds the evaluations of each seed, one per data set."""
    columns = [_column(seeds, [(split, predictor) for split in splits]) for splits in groups.values()]
    return Run([evaluation for per_seed in seeds for evaluation in per_seed], columns)


def _column(seeds: Sequence[Sequence[Evaluation]], keys: Sequence[tuple[str, str]]) -> Column:
    """Average over (split, predictor) keys and data sets with equal weights, then over seeds."""
    parts = [[e.means.get(key, {}) for e in per_seed for key in keys] for per_seed in seeds]
    shared = set.intersection(*(set(part) for per_seed in parts for part in per_seed))
    means, deviations = {}, {}
    for name in (name for name in parts[0][0] if name in shared):
        by_seed = [mean_of_parts([part[name] for part in per_seed]) for per_seed in parts]
        means[name] = mean_of_seeds(by_seed)
        if len(by_seed) > 1:
            deviations[name] = float(np.std([estimate.mean for estimate in by_seed], ddof=1))
    return Column(means, deviations)

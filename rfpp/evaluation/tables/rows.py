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

#: Name of the table of what neither of the paper's has a place for.
OTHERS = "others"

#: Heading of a group of columns → the splits it is a mean over.
Groups = Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Column:
    """One group of columns in one line of a table.

    Attributes:
        means: by metric, over splits, data sets and seeds; empty where one of them is missing.
        deviations: by metric, the standard deviation over seeds; empty for a single seed.
    """

    means: Estimates
    deviations: Mapping[str, float]


@dataclass(frozen=True)
class Run:
    """Measurements of one training, or of several that differ only in their seeds.

    Attributes:
        evaluations: of each seed on each data set.
        columns: for each group of columns.
    """

    evaluations: Sequence[Evaluation]
    columns: Sequence[Column]

    @property
    def seeds(self) -> list[int]:
        return sorted({evaluation.seed for evaluation in self.evaluations})


@dataclass(frozen=True)
class Row:
    """A method in a table.

    Attributes:
        label: what it is called there.
        runs: ours; none if it was not run.
        paper: the paper's numbers, by metric for each group of columns; None if it is not in the paper.
        paper_steps: how long it was trained there, if that is known.
        is_baseline: it has no network and nothing that was trained, so one run at most.
    """

    label: str
    runs: Sequence[Run]
    paper: Sequence[Mapping[str, float]] | None = None
    paper_steps: int | None = None
    is_baseline: bool = False


@dataclass(frozen=True)
class ResultTable:
    """A table of rows in named blocks, with the metrics that are its columns in each of its groups."""

    name: str
    title: str
    groups: Groups
    metrics: Sequence[str]
    blocks: Sequence[tuple[str, Sequence[Row]]]

    def evaluations(self) -> list[Evaluation]:
        """All that its networks' numbers come from."""
        rows = (row for _, rows in self.blocks for row in rows if not row.is_baseline)
        return [evaluation for row in rows for run in row.runs for evaluation in run.evaluations]


def paper_table(table: PaperTable, evaluations: Sequence[Evaluation]) -> ResultTable:
    """A table of the paper with our numbers in it; a row whose data sets or splits are incomplete counts as not run."""
    blocks = []
    for block in table.blocks:
        rows = []
        for row in block.rows:
            mine = [e for e in evaluations if e.method == row.method]
            runs = [r for r in _runs(mine, block.data, table.groups) if all(c.means for c in r.columns)]
            numbers = np.reshape(row.values, (len(table.groups), len(PAPER_METRICS))).tolist()
            of_paper = [dict(zip(PAPER_METRICS, group, strict=True)) for group in numbers]
            rows.append(Row(row.label, runs, of_paper, row.steps))
        blocks.append((block.heading, [*rows, *_baseline_rows(evaluations, block.data, table.groups)]))
    return ResultTable(table.name, table.title, table.groups, PAPER_METRICS, blocks)


def other_table(evaluations: Sequence[Evaluation], placed: Sequence[Evaluation]) -> ResultTable:
    """All evaluations that are not `placed` in another table, one block per data set."""
    others = [e for e in evaluations if not any(e is other for other in placed)]
    groups = {split: (split,) for e in others for split, _ in e.means}
    blocks = []
    for data in sorted({e.data for e in others}):
        mine = [e for e in others if e.data == data]
        methods = dict.fromkeys(e.method for e in mine)
        rows = [Row(method, _runs([e for e in mine if e.method == method], (data,), groups)) for method in methods]
        blocks.append((f"Data set '{data}'", [*rows, *_baseline_rows(mine, (data,), groups)]))
    metrics = list(dict.fromkeys(name for e in others for name in e.definitions))
    return ResultTable(OTHERS, "Evaluations beyond the paper's tables", groups, metrics, blocks)


def _runs(evaluations: Sequence[Evaluation], data: Sequence[str], groups: Groups) -> list[Run]:
    """The runs of one method whose seeds were evaluated on all of these data sets."""
    trainings: dict[tuple, dict[int, list[Evaluation]]] = defaultdict(lambda: defaultdict(list))
    for e in evaluations:
        if e.data in data:
            trainings[e.trained_on, e.steps, e.commit][e.seed].append(e)
    runs = []
    for seeds in trainings.values():
        complete = [seeds[seed] for seed in sorted(seeds) if len(seeds[seed]) == len(data)]
        if complete:
            runs.append(_run(complete, MODEL, groups))
    return runs


def _baseline_rows(evaluations: Sequence[Evaluation], data: Sequence[str], groups: Groups) -> list[Row]:
    """Rows of the baselines; they depend only on the data, so any evaluation of a data set has their numbers."""
    by_data = {e.data: e for e in evaluations if e.data in data}
    if len(by_data) < len(data):
        return []
    names = dict.fromkeys(who for e in by_data.values() for _, who in e.means if who != MODEL)
    rows = [Row(name, [_run([list(by_data.values())], name, groups)], is_baseline=True) for name in names]
    return [row for row in rows if any(column.means for column in row.runs[0].columns)]


def _run(seeds: Sequence[Sequence[Evaluation]], predictor: str, groups: Groups) -> Run:
    """Args: seeds: for each seed its evaluations, one per data set."""
    columns = [_column(seeds, [(split, predictor) for split in splits]) for splits in groups.values()]
    return Run([evaluation for of_seed in seeds for evaluation in of_seed], columns)


def _column(seeds: Sequence[Sequence[Evaluation]], keys: Sequence[tuple[str, str]]) -> Column:
    """The mean over `keys` (split, predictor) and data sets with equal weights, then over seeds."""
    parts = [[e.means.get(key, {}) for e in of_seed for key in keys] for of_seed in seeds]
    shared = set.intersection(*(set(part) for of_seed in parts for part in of_seed))
    means, deviations = {}, {}
    for name in (name for name in parts[0][0] if name in shared):
        by_seed = [mean_of_parts([part[name] for part in of_seed]) for of_seed in parts]
        means[name] = mean_of_seeds(by_seed)
        if len(by_seed) > 1:
            deviations[name] = float(np.std([estimate.mean for estimate in by_seed], ddof=1))
    return Column(means, deviations)

"""Run a benchmark: print a table and, with output=…, write a CSV file with commit and hardware.

python launch/benchmark.py benchmark=reference output=data/results/reference.csv
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from rfpp.commands import entry_point
from rfpp.evaluation.measuring.csv_files import Row, write_rows
from rfpp.training.tracking.description import code_version, hardware


@entry_point("benchmark")
def main(cfg: DictConfig) -> list[Row]:
    """Run the benchmark `cfg.benchmark`; returns its rows. `cfg.output` has them as soon as they are measured."""
    console = Console()
    commit = code_version() or "unknown"  # of what runs: others may commit meanwhile
    measure = instantiate(cfg.benchmark, _convert_="all")
    rows: list[Row] = []
    with _bar(console) as show:
        try:
            for row in measure(progress=show):
                where = {"commit": commit, "hardware": hardware(torch.device(row.get("device", "cpu")))}
                rows.append({**row, **where, **row})  # rows of an earlier run know theirs
                if cfg.output is not None:
                    write_rows(Path(cfg.output), rows)
        except KeyboardInterrupt:
            if not rows:
                raise
            console.print("interrupted: these rows were finished")
    table = _table([{name: row[name] for name in row if name not in where} for row in rows])
    unbounded = console.options.update(max_width=1000)
    console.width = max(console.width, console.measure(table, options=unbounded).maximum)  # break lines, not words
    console.print(table)
    if cfg.output is not None:
        console.print(f"Written: {cfg.output}", highlight=False, soft_wrap=True)
    return rows


@contextmanager
def _bar(console: Console) -> Iterator[Callable[[int, int], None]]:
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("measuring", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _table(rows: list[Row]) -> Table:
    """What differs between the rows in columns; what does not, above them."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    values = {name: [row.get(name) for row in rows] for name in names}
    same = {name: of[0] for name, of in values.items() if len(rows) > 1 and all(value == of[0] for value in of)}
    names = [name for name in names if name not in same]
    table = Table(*(Column(name, no_wrap=True) for name in names), box=None, pad_edge=False, title_justify="left")
    table.title = ", ".join(f"{name} {_cell(value)}" for name, value in same.items())
    for row in rows:
        table.add_row(*(_cell(row.get(name)) for name in names))
    return table


def _cell(value: str | int | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()

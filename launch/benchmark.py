"""Run a benchmark: print a table and, with output=…, write it as CSV with commit and hardware.

python launch/benchmark.py benchmark=reference output=data/results/reference.csv
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: the other imports take seconds)

# isort: split
from pathlib import Path

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from rfpp.benchmark.csv_rows import Row
from rfpp.commands import entry_point
from rfpp.evaluation.measuring.csv_files import write_rows
from rfpp.training.tracking.description import code_version, hardware


@entry_point("benchmark")
def main(cfg: DictConfig) -> list[Row]:
    """Run the benchmark `cfg.benchmark` and return its rows; `cfg.output` is written after every row."""
    console = Console()
    commit = code_version() or "unknown"  # read first: others may commit meanwhile
    measure = instantiate(cfg.benchmark, _convert_="all")
    rows: list[Row] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("measuring", total=None)
        try:
            for row in measure(progress=lambda done, total: progress.update(task, completed=done, total=total)):
                source = {"commit": commit, "hardware": hardware(torch.device(row.get("device", "cpu")))}
                rows.append({**row, **source, **row})  # rows of an earlier run keep their own
                if cfg.output is not None:
                    write_rows(Path(cfg.output), rows)
        except KeyboardInterrupt:
            if not rows:
                raise
            console.print("interrupted: these rows are complete")
    table = _table([{name: value for name, value in row.items() if name not in source} for row in rows])
    unbounded = console.options.update(max_width=1000)
    console.width = max(console.width, console.measure(table, options=unbounded).maximum)  # break lines, not words
    console.print(table)
    if cfg.output is not None:
        console.print(f"Written: {cfg.output}", highlight=False, soft_wrap=True)
    return rows


def _table(rows: list[Row]) -> Table:
    """Put what differs between the rows into columns, and shared values above them."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    values = {name: [row.get(name) for row in rows] for name in names}
    shared = {name: of[0] for name, of in values.items() if len(rows) > 1 and all(value == of[0] for value in of)}
    names = [name for name in names if name not in shared]
    table = Table(*(Column(name, no_wrap=True) for name in names), box=None, pad_edge=False, title_justify="left")
    table.title = ", ".join(f"{name} {_cell(value)}" for name, value in shared.items())
    for row in rows:
        table.add_row(*(_cell(row.get(name)) for name in names))
    return table


def _cell(value: str | int | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()

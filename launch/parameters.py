"""Count the parameters of every network in the paper's tables, stage by stage.

python launch/parameters.py --size base --output data/results/parameters.csv
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first, because the imports below take seconds)

# isort: split
import argparse
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from rich.console import Console
from rich.table import Column, Table

from rfpp.commands import CONFIG_DIR
from rfpp.evaluation.measuring.csv_files import write_rows
from rfpp.training.run import parameter_counts

STAGES = ("embedding", "tokenizer", "transport", "decoder", "total")


def counts_by_method(size: str) -> dict[str, dict[str, int]]:
    """Return parameters by method and stage, for the full network and every row of the paper."""
    variants = sorted(path.stem for path in (CONFIG_DIR / "experiment" / "paper").glob("*.yaml"))
    counts = {}
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        for experiment in ("large_scale", *(f"[large_scale,paper/{variant}]" for variant in variants)):
            cfg = compose("train", overrides=[f"experiment={experiment}", f"size={size}", "run_dir=unused"])
            with torch.device("meta"):  # shapes suffice
                counts[cfg.method] = parameter_counts(instantiate(cfg.model, _convert_="all"))
    return counts


def main(arguments: list[str] | None = None) -> Path | None:
    """Print the table; return the path of the CSV file, if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="base", choices=sorted(p.stem for p in (CONFIG_DIR / "size").glob("*.yaml")))
    parser.add_argument("--output", type=Path, help="also write the table as CSV")
    options = parser.parse_args(arguments)
    counts = counts_by_method(options.size)

    title = f"Millions of parameters, size {options.size}"
    table = Table(Column("", no_wrap=True), *STAGES, title=title, title_justify="left", box=None)
    for method, stages in counts.items():
        table.add_row(method, *(f"{stages.get(stage, 0) / 1e6:.2f}" for stage in STAGES))
    Console().print(table)
    if options.output is None:
        return None
    rows = [
        {"method": method, **{stage: stages.get(stage, 0) for stage in STAGES}} for method, stages in counts.items()
    ]
    return write_rows(options.output, rows)


if __name__ == "__main__":
    main()

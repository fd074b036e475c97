"""Count the parameters of every network in the paper's tables and of those beyond it, stage by stage.

python launch/parameters.py --size base
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
import argparse
import csv
import io
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Column, Table

from rfpp.commands import CONFIG_DIR
from rfpp.files import write_atomically
from rfpp.training.run import parameter_counts

STAGES = ("embedding", "tokenizer", "transport", "decoder", "total")


def counts_by_method(size: str) -> dict[str, dict[str, int]]:
    """Method → stage → parameters, for the full network and every variant in conf/experiment."""
    experiments = sorted((CONFIG_DIR / "experiment").glob("*.yaml"))
    variants = [path.stem for path in experiments if "variant" in OmegaConf.load(path)]
    counts = {}
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        for experiment in ("large_scale", *(f"[large_scale,{variant}]" for variant in variants)):
            cfg = compose("train", overrides=[f"experiment={experiment}", f"size={size}", "run_dir=unused"])
            with torch.device("meta"):  # shapes are enough
                counts[cfg.method] = parameter_counts(instantiate(cfg.model, _convert_="all"))
    return counts


def main(arguments: list[str] | None = None) -> Path | None:
    """Print the table; returns the CSV's path where one was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="base", choices=sorted(p.stem for p in (CONFIG_DIR / "size").glob("*.yaml")))
    parser.add_argument("--output", type=Path, help="also write the table as CSV, e.g. data/results/parameters.csv")
    options = parser.parse_args(arguments)
    counts = counts_by_method(options.size)

    table = Table(
        Column("", no_wrap=True), *STAGES, title=f"Millions of parameters, size {options.size}", title_justify="left"
    )
    for method, stages in counts.items():
        table.add_row(method, *(f"{stages.get(stage, 0) / 1e6:.2f}" for stage in STAGES))
    Console().print(table)
    if options.output is None:
        return None
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["method", *STAGES])
    writer.writerows([method, *(stages.get(stage, 0) for stage in STAGES)] for method, stages in counts.items())
    return write_atomically(options.output, stream.getvalue().encode())


if __name__ == "__main__":
    main()

"""Measure what networks add to known light, on scenes with clean references.

python launch/generate.py experiment=light_test
python launch/measure_light.py experiment=light_test checkpoint=[a/checkpoints/best.ckpt,b/checkpoints/best.ckpt]
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from functools import partial
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig
from rfpp.model.linear_transport import LinearTransport
from rfpp.model.radiosity import UnlearnedRadiosity
from rich.console import Console
from rich.table import Table

from rfpp.checkpoint.loading import load_network
from rfpp.commands import entry_point
from rfpp.evaluation.measuring.light import measure
from rfpp.evaluation.tables.light_table import COLUMNS, light_row, write_light_rows
from rfpp.model.layers.matrix_precision import matrix_dtype
from rfpp.progress import progress_bars
from rfpp.shards.dataset import ShardSplit
from rfpp.training.tracking.description import code_version, hardware


@entry_point("measure_light")
def main(cfg: DictConfig) -> Path:
    """Measure known light, radiosity and each of `cfg.checkpoint` on `cfg.split`, on the CPU; returns the table."""
    console = Console(highlight=False, soft_wrap=True)
    given = [cfg.checkpoint] if isinstance(cfg.checkpoint, str) else list(cfg.checkpoint or [])
    loaded = {name: load_network(name) for name in given}
    radiosity = UnlearnedRadiosity().eval()
    predictors = {"known light alone": None, radiosity.name: radiosity}
    predictors |= {name: network.eval() for name, (network, _) in loaded.items()}
    if cfg.bounces is not None:
        for moving in (
            radiosity,
            *(n.transport for n, _ in loaded.values() if isinstance(n.transport, LinearTransport)),
        ):
            moving.iterations = cfg.bounces - 1  # from cells to pixels is the last
    split = ShardSplit(cfg.data.root, cfg.split, instantiate(cfg.datamodule.source.cache))
    device = torch.device("cpu")
    dtype = matrix_dtype("auto", device)
    autocast = partial(torch.autocast, "cpu", dtype, enabled=dtype != torch.float32)
    with progress_bars(console) as bar:
        errors = measure(predictors, split, Path(cfg.clean), autocast, bar("scenes", len(split)))
    about = {"commit": (code_version() or "")[:12], "hardware": hardware(device)}
    named = split.manifest.name if cfg.split == "test" else f"{split.manifest.name}, {cfg.split}"
    about |= {"data": named, "manifest": split.manifest.hash[:12]}
    about |= {"bounces": "" if cfg.bounces is None else cfg.bounces}
    infos = {name: info for name, (_, info) in loaded.items()}
    rows = [about | light_row(name, infos.get(name), of_one) for name, of_one in errors.items()]
    table = _table(rows)
    unbounded = console.options.update(max_width=1000)
    console.width = max(console.width, console.measure(table, options=unbounded).maximum)  # break lines, not words
    console.print(table)
    file = write_light_rows(rows, Path(cfg.output))
    console.print(f"Table: {file}")
    return file


def _table(rows: list[dict[str, Any]]) -> Table:
    table = Table(
        "",
        "seed",
        "further light, rel. L1",
        "median",
        "energy",
        "log-L1",
        "other tokens",
        "permuted light",
        "no transport",
    )
    for row in rows:
        spread = f"{row['further_light']:.3f} ({row['further_light_low']:.3f}–{row['further_light_high']:.3f})"
        middle = [f"{row['further_light_median']:.3f}", f"{row['further_energy']:.2f}", f"{row['log_l1']:.5f}"]
        growth = [row.get(name) for name in COLUMNS[-3:]]
        parts = ["" if value is None else f"{value:+.0%}" for value in growth]
        table.add_row(row["method"], str(row.get("seed", "")), spread, *middle, *parts)
    return table


if __name__ == "__main__":
    main()

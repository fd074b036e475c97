"""Measure time, memory and operations of rendering and training over scene and image sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import Limits, in_fresh_process
from rfpp.benchmark.cost.rows import Row, new_rows, read_rows, rows_of
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.benchmark.cost.turns import Rounds, take_turns
from rfpp.errors import UserError
from rfpp.training.flops import matrix_product_rate


def measure(
    networks: Mapping[str, Untrained],
    tasks: Mapping[str, Task],
    case: Case,
    sweeps: Mapping[str, Sequence[Mapping[str, int]]],
    only: Sequence[str] | None,
    setting: Setting,
    rounds: Rounds,
    limits: Limits,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per case, quantity and network, as soon as it is measured; a case that sweeps share is measured once.

    Times are medians over rounds in which all networks take turns, each in a process of its own that does nothing
    else. `speedup` and `memory_saved` (a share) compare a network with the first one. `peak_GB` is what weights, batch,
    activations and, in training, gradients and moments take at most, of which `held_GB` are there before: as CUDA's
    allocator counts, or resident memory beyond what the process held without them. `TFLOP` are counted for every case,
    also where nothing could be measured, and `of_matrix_rate` is their rate as a share of what the device does in
    products of large matrices. What runs out of memory or time has a row whose status says so.

    Args:
        networks: by any key; the first is the baseline.
        tasks: by name.
        case: that the sweeps vary.
        sweeps: name → what differs from `case`, point by point.
        only: these sweeps, or None for all.
        setting, rounds, limits: how, how often, how long and how large.
        finished: rows of an earlier run, if the file exists: they come first, and what they tell is not measured again.
        progress: called with (turns taken, turns in all).

    Raises:
        UserError: no such sweep, a case that cannot be, or `finished` is no such table.
    """
    points = _points(case, sweeps, only)
    compared = list(networks.values())
    _require_divisible(compared, [at for _, at in points])
    known = read_rows(Path(finished)) if finished and Path(finished).exists() else []
    yield from known
    device = in_fresh_process(_device_columns, setting)
    wanted = [(sweep, at, task) for sweep, at in points for task in tasks.values()]
    missing = {(at, task.quantities) for _, at, task in wanted if not rows_of(known, at, task, device)}
    turns = len(networks) * (1 + rounds.count)
    taken, total = 0, turns * len(missing)
    progress(0, total)
    for sweep, at, task in wanted:
        there = rows_of(known, at, task, device)
        if there and there[0]["sweep"] == sweep:
            continue
        if not there:
            shown = partial(_further, progress, taken, total)
            results = take_turns(compared, task, at, setting, rounds, limits, shown)
            flops = {network.name: _flops(network, task, at, setting.seed) for network in compared}
            rate = float(device["matrix_TFLOP_per_s"])
            there = [{"sweep": "", **vars(at), **row, **device} for row in new_rows(task, results, flops, rate)]
            taken += turns
        rows = [{**row, "sweep": sweep} for row in there]
        known += rows
        yield from rows


def _further(progress: Callable[[int, int], None], taken: int, total: int, turns: int) -> None:
    progress(taken + turns, total)


def _points(
    case: Case, sweeps: Mapping[str, Sequence[Mapping[str, int]]], only: Sequence[str] | None
) -> list[tuple[str, Case]]:
    """(sweep, case) in order."""
    chosen = list(sweeps) if only is None else only
    for name in chosen:
        if name not in sweeps:
            raise UserError(f"benchmark.only names '{name}': the sweeps are {', '.join(sweeps)}")
    points = []
    for name in chosen:
        for changes in sweeps[name]:
            if unknown := changes.keys() - vars(case).keys():
                raise UserError(f"sweep '{name}' varies {', '.join(unknown)}: a case has {', '.join(vars(case))}")
            points.append((name, replace(case, **changes)))
    return points


def _require_divisible(networks: Sequence[Untrained], cases: Sequence[Case]) -> None:
    for network in networks:
        patch = network("meta").patch_size
        for case in cases:
            if case.resolution % patch:
                raise UserError(
                    f"resolution {case.resolution} does not divide into {network.name}'s patches of {patch}"
                )


def _flops(network: Untrained, task: Task, case: Case, seed: int) -> dict[str, float]:
    """By shapes alone: the counter does not know every kernel, but these are composed of matrix products."""
    made = network("meta")
    return task.flops(made, case.batch(made.gbuffer_channels, seed).to("meta"))


def _device_columns(setting: Setting) -> Row:
    """What all rows have in common."""
    setting.apply()
    return {
        "device": setting.where,
        "precision": setting.precision,
        "compiled": str(setting.compile).lower(),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "matrix_TFLOP_per_s": matrix_product_rate(torch.device(setting.where), setting.dtype) / 1e12,
    }

"""What networks cost: time, memory and operations of rendering and of training, over the sizes of scenes and images."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Any

import torch

from rfpp.benchmark.cost_case import Case
from rfpp.benchmark.cost_process import GB, Limits, MeasuringProcess, NotMeasuredError, Turn, in_fresh_process
from rfpp.benchmark.cost_tasks import Setting, Task, Untrained
from rfpp.errors import UserError
from rfpp.training.flops import matrix_product_rate

Row = dict[str, str | int | float | None]

OK = "ok"


@dataclass(frozen=True)
class Rounds:
    """How often each measurement is taken.

    Attributes:
        count: rounds in which the networks take turns, after a first one that chooses and loads kernels. That one
            counts only where there was no other.
        enough_seconds: a network whose turns took so long together has no further one.
    """

    count: int
    enough_seconds: float | int


@dataclass
class Result:
    """What one network did with one task in one case: its turns, or why there are none."""

    turns: list[Turn] = field(default_factory=list)
    status: str = OK
    spent: float = 0.0

    @property
    def counted(self) -> list[Turn]:
        return self.turns[1:] or self.turns

    def seconds(self, quantity: str) -> list[float]:
        return [turn.seconds[quantity] for turn in self.counted]


def measure(
    networks: Mapping[str, Untrained],
    tasks: Mapping[str, Task],
    case: Case,
    sweeps: Mapping[str, Sequence[Mapping[str, int]]],
    only: Sequence[str] | None,
    setting: Setting,
    rounds: Rounds,
    limits: Limits,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """A row per case, quantity and network; a case that several sweeps share is measured once.

    Times are medians over rounds in which all networks take turns, each in a process of its own that does nothing
    else. `speedup` and `memory_saved` (a share) compare a network with the first one. `peak_GB` is what weights, batch,
    activations and, in training, gradients and moments take at most, of which `held_GB` are there before: as CUDA's
    allocator counts, or resident memory beyond what the process held without them. `TFLOP` are counted for every case,
    also where nothing could be measured, and `of_matrix_rate` is their rate as a share of what the device does in
    products of large matrices. What runs out of memory or time has a row whose status says so. Ctrl-C ends the
    measuring; what is finished is returned.

    Args:
        networks: by any key; the first is the baseline.
        tasks: by name.
        case: that the sweeps vary.
        sweeps: name → what differs from `case`, point by point.
        only: these sweeps, or None for all.
        setting, rounds, limits: how, how often, how long and how large.
        progress: called with (turns taken, turns in all).

    Raises:
        UserError: no such sweep, or a case that cannot be.
    """
    points = _points(case, sweeps, only)
    compared = list(networks.values())
    cases = list(dict.fromkeys(point for _, point in points))
    _require_divisible(compared, cases)
    device = in_fresh_process(_device_columns, setting)
    results: dict[tuple[Case, str], dict[str, Result]] = {}
    turns = len(networks) * (1 + rounds.count)
    total = turns * len(cases) * len(tasks)
    progress(0, total)
    try:
        for at in cases:
            for name, task in tasks.items():
                before = turns * len(results)
                results[at, name] = _take_turns(
                    compared, task, at, setting, rounds, limits, lambda n, before=before: progress(before + n, total)
                )
    except KeyboardInterrupt:
        if not results:
            raise
        warnings.warn(f"interrupted: rows of {len(results)} measurements of {len(cases) * len(tasks)}", stacklevel=2)
    rows = []
    for sweep, at in points:
        for name, task in tasks.items():
            if (at, name) in results:
                flops = {network.name: _flops(network, task, at, setting.seed) for network in compared}
                rows += [
                    {"sweep": sweep, **vars(at), **row, **device}
                    for row in _rows(task, results[at, name], flops, float(device["matrix_TFLOP_per_s"]))
                ]
    return rows


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


def _take_turns(
    networks: Sequence[Untrained],
    task: Task,
    case: Case,
    setting: Setting,
    rounds: Rounds,
    limits: Limits,
    made: Callable[[int], None],
) -> dict[str, Result]:
    """Network → result. One that fails leaves the others the rest of the rounds."""
    results = {network.name: Result() for network in networks}
    with ExitStack() as stack:
        processes = {
            network.name: stack.enter_context(MeasuringProcess(network, task, case, setting, limits))
            for network in networks
        }
        for name, process in processes.items():  # before any turn: preparing would disturb it
            _attempt(results[name], process.ready)
        for turn in range(1 + rounds.count):
            for number, (name, process) in enumerate(processes.items(), start=1):
                result = results[name]
                if result.status == OK and result.spent <= rounds.enough_seconds:
                    _attempt(result, process.turn)
                made(turn * len(networks) + number)
    return results


def _attempt(result: Result, do: Callable[[], Turn | None]) -> None:
    """Add a turn to a result, or the reason why there is none."""
    begin = time.monotonic()
    try:
        turn = do()
        if turn is not None:
            result.turns.append(turn)
            result.spent += time.monotonic() - begin
    except NotMeasuredError as reason:
        result.status = str(reason)


def _rows(task: Task, results: Mapping[str, Result], flops: Mapping[str, dict[str, float]], rate: float) -> list[Row]:
    """A row per quantity and network."""
    rows = []
    for quantity in task.quantities:
        measured: dict[str, dict[str, Any]] = {}
        for name, result in results.items():
            whole = quantity == task.quantities[-1]
            measured[name] = _figures(result, quantity, whole) | {"TFLOP": flops[name][quantity] / 1e12}
        baseline = next(iter(measured.values()))
        for name, own in measured.items():
            seconds, peak = own["seconds"], own["peak_GB"]
            per_second = seconds and own["TFLOP"] / seconds
            rows.append(
                {
                    "quantity": quantity,
                    "network": name,
                    **own,
                    "speedup": baseline["seconds"] / seconds if seconds and baseline["seconds"] else None,
                    "memory_saved": 1 - peak / baseline["peak_GB"] if peak and baseline["peak_GB"] else None,
                    "TFLOP_per_s": per_second,
                    "of_matrix_rate": per_second and per_second / rate,
                }
            )
    return rows


def _figures(result: Result, quantity: str, whole: bool) -> dict[str, Any]:
    if not result.turns:
        return {"status": result.status, "rounds": 0} | dict.fromkeys(("seconds", "seconds_min", "peak_GB", "held_GB"))
    seconds = result.seconds(quantity)
    return {
        "status": OK,  # a later turn that failed takes nothing from those before
        "rounds": len(seconds),
        "seconds": median(seconds),
        "seconds_min": min(seconds),
        "peak_GB": result.turns[-1].peak / GB if whole else None,
        "held_GB": result.turns[-1].held / GB if whole else None,
    }


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

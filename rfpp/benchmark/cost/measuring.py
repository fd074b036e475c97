"""Measure time, memory and operations of rendering and training over scene and image sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import nn

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import SEED, NotMeasuredError, Turn, Worker
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.benchmark.csv_rows import Row, read_rows
from rfpp.errors import UserError
from rfpp.training.flops import published_peak
from rfpp.training.tracking.description import hardware

OK = "ok"
#: Columns of every table that plots and resumed runs read.
COLUMNS = {*Case.__dataclass_fields__, "compiled", "quantity", "network", "status", "seconds", "peak_GB"}


@dataclass(frozen=True)
class Point:
    """Measurement of one task in one case by networks that take turns."""

    task: str
    networks: tuple[str, ...]
    compiled: bool
    case: Case


@dataclass(frozen=True)
class Rounds:
    """Number and duration of turns."""

    count: int
    enough_seconds: float | int
    timeout: float | int


def points(
    groups: Sequence[Mapping[str, Any]], case: Case, tasks: Sequence[str], networks: Sequence[str]
) -> list[Point]:
    """Return the Cartesian product of each group's values, each point once.

    Raises:
        UserError: If a group names an unknown field, task or network, or an impossible case.
    """
    defaults: dict[str, Any] = {"networks": networks, "task": list(tasks), "compiled": False, **vars(case)}
    found = []
    for group in groups:
        together, *values = {**defaults, **group}.values()
        lists = [value if isinstance(value, list) else [value] for value in values]
        named = [("field", group, defaults), ("network", together, networks), ("task", lists[0], tasks)]
        for kind, given, known in named:
            if unknown := set(given) - set(known):
                raise UserError(f"benchmark.groups: unknown {kind} '{min(unknown)}': choose from {', '.join(known)}")
        combinations = product(*lists)
        found += [Point(task, tuple(together), compiled, Case(*sizes)) for task, compiled, *sizes in combinations]
    return list(dict.fromkeys(found))


def measure(
    networks: Mapping[str, Untrained],
    tasks: Mapping[str, Task],
    case: Case,
    groups: Sequence[Mapping[str, Any]],
    setting: Setting,
    rounds: Rounds,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per point, quantity and network as soon as the point is measured.

    Networks take turns, each in its own process. `seconds` is the median over turns. `speedup` and `memory_saved` (a
    share) compare a network with the first one. `peak_GB` is the maximum taken by weights, batch, activations and, in
    training, gradients and moments, of which `held_GB` exists before the first turn: counted by CUDA's allocator, or
    as resident memory beyond what the process held without them. `of_peak` (MFU) is the rate of the counted
    operations as a share of the card's published rate. A network that exceeds memory or time has a row with that
    status.

    Raises:
        UserError: If a group or a resolution is invalid, or `finished` is not such a table.
    """
    wanted = points(groups, case, list(tasks), list(networks))
    shapes = {key: network("meta") for key, network in networks.items()}
    for size, key in {(point.case.resolution, key) for point in wanted for key in point.networks}:
        if size % (patch := shapes[key].patch_size):
            raise UserError(f"resolution {size} does not divide into {networks[key].name}'s patches of {patch}")
    earlier = read_rows(Path(finished), "cost", COLUMNS) if finished and Path(finished).exists() else []
    yield from earlier
    setting.apply()
    conditions = {
        "device": setting.where,
        "precision": setting.precision,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "hardware": hardware(torch.device(setting.where)),
    }

    def identity(point: Point, key: str, quantity: str) -> Row:
        """Return the columns that say what a row measures, and under which conditions."""
        parameters = sum(parameter.numel() for parameter in shapes[key].parameters())
        case = {**vars(point.case), "compiled": str(point.compiled).lower()}
        return {**case, "quantity": quantity, "network": networks[key].name, "parameters": parameters, **conditions}

    known = [set(row.items()) for row in earlier]

    def is_measured(point: Point) -> bool:
        pairs = product(point.networks, tasks[point.task].quantities)
        rows = [{(name, str(value)) for name, value in identity(point, *pair).items()} for pair in pairs]
        return all(any(row <= other for other in known) for row in rows)

    missing = [point for point in wanted if not is_measured(point)]
    taken, total = 0, (1 + rounds.count) * sum(len(point.networks) for point in missing)
    progress(taken, total)
    for point in missing:
        task = tasks[point.task]
        results = {key: _Result([], OK) for key in point.networks}
        for _ in _turns(networks, point, task, setting, rounds, results):
            taken += 1
            progress(taken, total)
        flops = {key: _flops(shapes[key], task, point.case) for key in results}
        for quantity in task.quantities:
            rows = {key: _figures(result, flops[key], quantity, task, setting) for key, result in results.items()}
            for key, row in rows.items():
                compared = _compared(rows[point.networks[0]], row) if len(rows) > 1 else {}
                yield identity(point, key, quantity) | row | compared


@dataclass
class _Result:
    """Turns of one network, and the reason if it stopped early."""

    turns: list[Turn]
    status: str

    def attempt(self, execute: Callable[[], Turn | None]) -> None:
        """Add a turn, or the reason why there is none."""
        try:
            if turn := execute():
                self.turns.append(turn)
        except NotMeasuredError as reason:
            self.status = str(reason)


def _turns(
    networks: Mapping[str, Untrained],
    point: Point,
    task: Task,
    setting: Setting,
    rounds: Rounds,
    results: Mapping[str, _Result],
) -> Iterator[None]:
    """Let networks take turns and add these to the results; one that fails does not stop the others."""
    with ExitStack() as stack:
        workers = {
            key: stack.enter_context(Worker(networks[key], task, point.case, point.compiled, setting, rounds.timeout))
            for key in point.networks
        }
        for key, worker in workers.items():  # before any turn, which preparing would disturb
            results[key].attempt(worker.ready)
        for key in (1 + rounds.count) * point.networks:
            result = results[key]
            spent = sum(turn.seconds[task.quantities[-1]] for turn in result.turns)
            if result.status == OK and spent <= rounds.enough_seconds:
                result.attempt(workers[key].turn)
            yield


def _flops(network: nn.Module, task: Task, case: Case) -> dict[str, float]:
    """Count operations from shapes alone."""
    return task.flops(network, case.batch(network.gbuffer_channels, SEED).to("meta"))


def _figures(result: _Result, flops: Mapping[str, float], quantity: str, task: Task, setting: Setting) -> Row:
    """Return the measured columns of one network; a turn that failed leaves those before it valid."""
    counted = result.turns[1:] or result.turns  # the first turn warms up, and counts only if it is the only one
    seconds = [turn.seconds[quantity] for turn in counted]
    last = counted[-1] if counted and quantity == task.quantities[-1] else None
    rate = flops[quantity] / median(seconds) if seconds else None
    peak = published_peak(torch.device(setting.where), setting.dtype)
    return {
        "status": OK if seconds else result.status,
        "rounds": len(seconds),
        "seconds": median(seconds) if seconds else None,
        "seconds_min": min(seconds, default=None),
        "peak_GB": last and last.peak / 1e9,
        "held_GB": last and last.held / 1e9,
        "TFLOP": flops[quantity] / 1e12,
        "TFLOP_per_s": rate and rate / 1e12,
        "of_peak": rate / peak if rate and peak else None,
    }


def _compared(baseline: Row, row: Row) -> Row:
    seconds, peaks = (baseline["seconds"], row["seconds"]), (baseline["peak_GB"], row["peak_GB"])
    return {
        "speedup": seconds[0] / seconds[1] if all(seconds) else None,
        "memory_saved": 1 - peaks[1] / peaks[0] if all(peaks) else None,
    }

"""Measure networks in turns, each in its own process."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import Limits, MeasuringProcess, NotMeasuredError, Turn
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained

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


def take_turns(
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

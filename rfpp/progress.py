"""Progress of commands: a bar in a terminal, a log line per minute elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn


class Count:
    """Progress so far: `done` things of `total`; `before` of them were done at the start."""

    def __init__(self) -> None:
        self.done = self.total = 0
        self.before: int | None = None

    @property
    def made(self) -> int:
        """Things done since the start."""
        return self.done - (self.before or 0)


@contextmanager
def counting(console: Console, things: str, each: int = 1) -> Iterator[tuple[Callable[..., None], Count]]:
    """Show a progress bar; yield a function to call with (done, total, note) and the count.

    The bar is visible unless everything is done at the first call. The note is optional; None keeps the last one.

    Args:
        things: Name of what is counted, in the plural.
        each: Number of things per step of the work.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _PerSecond())
    note_column = TextColumn("{task.fields[note]}")
    with Progress(*columns, TimeRemainingColumn(), note_column, console=console) as progress:
        count, bars, notes = Count(), [], [""]
        lines = None if console.is_terminal else ProgressLines(things, console.print)

        def show(done: int, total: int, note: str | None = None) -> None:
            count.done, count.total = done, total
            if note is not None:
                notes[0] = note
            if not bars:
                count.before = done
                fields = {"total": total * each, "before": done * each, "visible": done < total, "note": ""}
                bars.append(progress.add_task(things, **fields))
            progress.update(bars[0], completed=done * each, note=notes[0])
            if lines:
                lines(done * each, total * each, notes[0])

        yield show, count


class ProgressLines:
    """Writes a line per minute: the count, the speed, and the remaining time.

    Args:
        things: Name of what is counted, in the plural.
        first_after: Number of things before the first line, which gives a first estimate of the time.
        clock: Function that returns the time in seconds.
    """

    def __init__(
        self,
        things: str,
        write: Callable[[str], object],
        every_n_seconds: float = 60.0,
        first_after: int = 10,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.things, self.write, self.clock = things, write, clock
        self.every_n_seconds, self.first_after = every_n_seconds, first_after
        self._start: tuple[float, int] | None = None
        self._last_line: float | None = None

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Report progress; the first call gives the count that was done before."""
        now = self.clock()
        if self._start is None:
            self._start = now, done
        start, before = self._start
        new, elapsed = done - before, now - start
        early = new < self.first_after if self._last_line is None else now - self._last_line < self.every_n_seconds
        if not new or early or done >= total:
            return
        self._last_line = now
        remaining = timedelta(seconds=round((total - done) * elapsed / new))
        speed = f"{new / elapsed:.2g} per second, " if elapsed else ""
        self.write(f"{self.things} {done} of {total}, {speed}about {remaining} left{note and f', {note}'}")


class _PerSecond(ProgressColumn):
    def render(self, task: Task) -> str:
        made = task.completed - task.fields["before"]
        return f"{made / task.elapsed:.1f} {task.description}/s" if made and task.elapsed else "starting"

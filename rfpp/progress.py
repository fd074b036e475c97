"""Progress of commands: a bar in a terminal, a log line per minute elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn

#: Things before the first line, which gives a first estimate of the time, and seconds between lines.
_FIRST_AFTER, _SECONDS_BETWEEN = 10, 60.0


class _PerSecond(ProgressColumn):
    def render(self, task: Task) -> str:
        made = task.completed - task.fields["before"]
        return f"{made / task.elapsed:.1f} {task.description}/s" if made and task.elapsed else "starting"


@contextmanager
def counting(console: Console, things: str, each: int = 1) -> Iterator[tuple[Callable[..., None], Count]]:
    """Show a progress bar; yield a function to call with (done, total, note) and the count.

    The bar is visible unless everything is done at the first call. The note is optional; None keeps the last one.

    Args:
        things: Name of the counted items, in the plural.
        each: Number of things per step of the work.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _PerSecond())
    note = TextColumn("{task.fields[note]}")
    with Progress(*columns, TimeRemainingColumn(), note, console=console) as progress:
        count = Count(progress, things, each)
        yield count.show, count


class Count:
    """Progress so far: `done` steps of `total`; `before` of them were done at the start."""

    def __init__(self, progress: Progress, things: str, each: int, clock: Callable[[], float] = time.monotonic):
        self.done = self.total = 0
        self.before: int | None = None
        self._progress, self._things, self._each, self._clock = progress, things, each, clock
        self._note, self._last_line = "", None

    @property
    def made(self) -> int:
        """Steps done since the start."""
        return self.done - (self.before or 0)

    def show(self, done: int, total: int, note: str | None = None) -> None:
        """Update the bar; write a line if it is time for one and no terminal shows the bar."""
        self.done, self.total, self._note = done, total, self._note if note is None else note
        if self.before is None:
            self.before, self._begin = done, self._clock()
            fields = {"total": total * self._each, "before": done * self._each, "visible": done < total, "note": ""}
            self._task = self._progress.add_task(self._things, **fields)
        self._progress.update(self._task, completed=done * self._each, note=self._note)
        if not self._progress.console.is_terminal and self._is_line_due():
            self._last_line = self._clock()
            elapsed, made = self._last_line - self._begin, self.made * self._each
            remaining = timedelta(seconds=round((total - done) * elapsed / self.made))
            speed = f"{made / elapsed:.2g} per second, " if elapsed else ""
            line = f"{self._things} {done * self._each} of {total * self._each}, {speed}about {remaining} left"
            self._progress.console.print(line + (self._note and f", {self._note}"))

    def _is_line_due(self) -> bool:
        if not self.made or self.done >= self.total:
            return False
        if self._last_line is None:
            return self.made * self._each >= _FIRST_AFTER
        return self._clock() - self._last_line >= _SECONDS_BETWEEN

"""Progress bars."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn

from rfpp.progress_lines import ProgressLines


class Count:
    """What a bar has seen: `done` things of `total`, `before` of which were there already."""

    def __init__(self) -> None:
        self.done = self.total = 0
        self.before: int | None = None

    @property
    def made(self) -> int:
        return self.done - (self.before or 0)


@contextmanager
def counting(console: Console, things: str, each: int = 1) -> Iterator[tuple[Callable[[int, int], None], Count]]:
    """A bar and its count: call the function yielded with (done, total); it is shown if anything is missing.

    Where no bar can be shown, a line a minute.

    Args:
        things: what is counted, in the plural.
        each: how many things one step of the work is.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _PerSecond())
    with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
        count, bars = Count(), []
        lines = None if console.is_terminal else ProgressLines(things, console.print)

        def show(done: int, total: int) -> None:
            count.done, count.total = done, total
            if not bars:
                count.before = done
                fields = {"total": total * each, "before": done * each, "visible": done < total}
                bars.append(progress.add_task(things, **fields))
            progress.update(bars[0], completed=done * each)
            if lines:
                lines(done * each, total * each)

        yield show, count


@contextmanager
def progress_bars(console: Console) -> Iterator[Callable[[str, int], Callable[[], None]]]:
    """Bars for the parts of one work: yields `bar(name, total)`, which returns what is called after each thing done.

    Where no bar can be shown, a line a minute.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:

        def bar(name: str, total: int) -> Callable[[], None]:
            task = progress.add_task(name, total=total)
            lines = None if console.is_terminal else ProgressLines(f"{name}:", console.print)
            done = itertools.count(1)

            def one_more() -> None:
                progress.update(task, completed=(so_far := next(done)))
                if lines:
                    lines(so_far, total)

            if lines:
                lines(0, total)
            return one_more

        yield bar


class _PerSecond(ProgressColumn):
    def render(self, task: Task) -> str:
        made = task.completed - task.fields["before"]
        return f"{made / task.elapsed:.1f} {task.description}/s" if made and task.elapsed else "starting"

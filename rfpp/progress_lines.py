"""Progress as log lines, for outputs without a moving bar such as files and Slurm logs."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta


class ProgressLines:
    """A line a minute: how much is done, how fast, and about how long the rest takes.

    Args:
        things: what is counted, in the plural.
        write: takes a line.
        every_n_seconds: between lines.
        first_after: things made before the first line, which says how long it will take.
        clock: seconds.
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
        self._begun: tuple[float, int] | None = None
        self._said: float | None = None

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """So many are done, of so many in all; the first call says how many were done before.

        Args:
            note: for the end of the line.
        """
        now = self.clock()
        if self._begun is None:
            self._begun = now, done
        begun, before = self._begun
        made, elapsed = done - before, now - begun
        soon = made < self.first_after if self._said is None else now - self._said < self.every_n_seconds
        if not made or soon or done >= total:
            return
        self._said = now
        left = timedelta(seconds=round((total - done) * elapsed / made))
        speed = f"{made / elapsed:.2g} a second, " if elapsed else ""
        self.write(f"{self.things} {done} of {total}, {speed}about {left} left{note}")

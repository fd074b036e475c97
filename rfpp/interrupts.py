"""Ctrl-C: what a command says then, and which of its processes hear it.

Importing this imports nothing that takes long: files in launch/ do so first, and Ctrl-C is answered in one line while
they import the rest.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import TracebackType

from rfpp.extras import missing_extra


@contextmanager
def unheard_by_children(signals: Iterable[int] = (signal.SIGINT,)) -> Iterator[None]:
    """Processes started meanwhile never get these signals, not even while they are being started.

    A terminal sends Ctrl-C to all processes of a command, of which only the first is to decide. Systems without signal
    masks ignore this.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        resource_tracker.ensure_running()  # multiprocessing's own child; when it starts, it unblocks two of them
        signal.pthread_sigmask(signal.SIG_BLOCK, signals)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What ends a command from outside, or before it begins: Ctrl-C, and a library that its file cannot import."""
    if issubclass(kind, KeyboardInterrupt):  # Python then ends by the signal, as shells expect
        print(f"interrupted: {str(error) or 'run the same command again'}", file=sys.stderr)
    elif missing := missing_extra(error):
        print(f"error: {missing}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _uncaught

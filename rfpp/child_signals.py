"""Which signals processes hear that this one starts."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


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

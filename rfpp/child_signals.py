"""Which signals processes hear that this one starts."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def unheard_by_children(signals: Iterable[int] = (signal.SIGINT,)) -> Iterator[None]:
    """Processes started meanwhile never get these signals, not even while they are being started.

    A terminal sends Ctrl-C to all processes of a command, of which only the first is to decide; it does so at the end
    of this block, as what is started by halves cannot be ended. Systems without signal masks ignore this.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        with _interrupted_later():
            resource_tracker.ensure_running()  # multiprocessing's own child; when it starts, it unblocks two of them
            signal.pthread_sigmask(signal.SIG_BLOCK, signals)
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """SIGINT is acted on at the end: no mask keeps it from a process of several threads."""
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: received.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if received:
            handler(*received[0])

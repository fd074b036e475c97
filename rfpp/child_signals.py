"""Keep signals from child processes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Collection, Iterator
from contextlib import contextmanager


@contextmanager
def blocked_in_children(signals: Collection[int] = (signal.SIGINT,)) -> Iterator[None]:
    """Block signals in all processes that are started in this block, for as long as they run.

    A terminal sends Ctrl-C to all processes of a command, and Slurm sends its signals to all processes of a job; the
    parent alone decides what to do. It handles signals that arrive meanwhile after the block.
    """
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # a child of multiprocessing's; starting it unblocks signals
    in_main = threading.current_thread() is threading.main_thread()
    handlers = {number: handler for number in signals if in_main and callable(handler := signal.getsignal(number))}
    arrived: set[int] = set()
    for number in handlers:  # other threads may receive what this one blocks
        signal.signal(number, lambda number, _: arrived.add(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived:
            signal.raise_signal(number)

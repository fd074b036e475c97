"""Keep signals from child processes."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


@contextmanager
def blocked_in_children(signals: Iterable[int] = (signal.SIGINT,)) -> Iterator[None]:
    """Block signals in all processes that are started in this block, for as long as they run.

    A terminal sends Ctrl-C to all processes of a command, and Slurm sends its signals to all processes of a job; the
    parent alone decides what to do. It handles signals that arrive meanwhile after the block. Windows has no signal
    masks: there the block has no effect.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # a child of multiprocessing's; starting it unblocks signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

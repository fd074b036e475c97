"""Signals that stop a training run: remembered by its ranks, blocked in its loader processes.

This module imports nothing heavy, so that launch/train.py can watch signals before it imports PyTorch.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children, parent_process
from types import FrameType

from rfpp.child_signals import blocked_in_children

#: Sent by Slurm before the time limit (launch/slurm/train.sbatch): save, and requeue the job.
REQUEUE = signal.SIGUSR1
#: Sent by Ctrl-C: save, and exit.
INTERRUPT = signal.SIGINT
#: Sent by `scancel`, `kill` and a machine that shuts down: save, and exit.
TERMINATE = signal.SIGTERM

#: By increasing priority, for ranks that received different signals: a person's signal overrides a scheduled one.
BY_PRIORITY = (REQUEUE, INTERRUPT, TERMINATE)


class StopSignals:
    """Remembers received signals; the training loop acts on them at the next step boundary.

    The handler does not save: ranks receive signals at different moments, and a rank that saves while another waits in
    an all-reduce would deadlock.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def watch(self) -> None:
        """Install the handlers, replacing others such as Lightning's, which save inside the handler."""
        if self.received != INTERRUPT:  # else the next Ctrl-C must end the process
            signal.signal(INTERRUPT, self._remember)
        for number in (REQUEUE, TERMINATE):
            signal.signal(number, self._remember)

    def take(self) -> signal.Signals | None:
        """Return the received signal and clear it."""
        received, self.received = self.received, None
        return received

    def _remember(self, number: int, _: FrameType | None) -> None:
        candidates = {signal.Signals(number), self.received} - {None}
        self.received = max(candidates, key=BY_PRIORITY.index)
        if number == INTERRUPT:
            signal.signal(INTERRUPT, signal.SIG_DFL)  # a second Ctrl-C ends the process at once
            if os.environ.get("LOCAL_RANK", "0") == "0":  # a terminal sends Ctrl-C to all ranks
                print("\nstopping after this step; Ctrl-C again ends at once", file=sys.stderr, flush=True)


#: Signals received by this process.
STOP_SIGNALS = StopSignals()


@contextmanager
def loaders_protected() -> Iterator[None]:
    """Block stop signals in loader processes that are started in this block.

    A signal to the whole job would kill the loaders, and training with them, before the ranks have saved. Loaders
    still alive when this process exits are killed, since they ignore the SIGTERM that multiprocessing sends.
    """
    try:
        with blocked_in_children(BY_PRIORITY):
            yield
    finally:
        # registered last, so that it runs before the exit handlers of multiprocessing and PyTorch, which would wait
        atexit.unregister(_kill_loaders)
        atexit.register(_kill_loaders)


def _kill_loaders() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # PyTorch's handler raises when a loader is killed
    for child in active_children():
        if child.daemon:
            child.kill()


def exit_with_parent(worker: int = 0) -> None:
    """End this loader process when its training process has ended, even if that was killed."""
    if (parent := parent_process()) is not None:
        threading.Thread(target=_exit_after, args=(parent,), name="parent-watch", daemon=True).start()


def _exit_after(parent: object) -> None:
    parent.join()
    os._exit(1)

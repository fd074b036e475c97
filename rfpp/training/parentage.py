"""End loader processes when their training process ends."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from multiprocessing import parent_process

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def end_with_parent(worker: int = 0) -> None:
    """Call in a child process: Linux then kills it when its parent ends.

    Elsewhere PyTorch's own watch has to do, which looks every few seconds, and not while a batch is made.

    Args:
        worker: its number, as DataLoader gives it.
    """
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = parent_process()
    if parent is not None and os.getppid() != parent.pid:  # it was gone before
        os.kill(os.getpid(), signal.SIGKILL)

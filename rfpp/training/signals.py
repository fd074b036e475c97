"""Remember stop signals from process start.

This imports nothing that takes long, so that launch/train.py can watch before it imports what does.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

#: What Slurm is asked to send before the time limit (launch/slurm/train.sbatch): save, and come back.
COME_BACK = signal.SIGUSR1
#: What `scancel`, `kill` and a machine that shuts down send: save, and end.
END = signal.SIGTERM
#: What Ctrl-C sends: the same. It is a wish to go on another time.
INTERRUPT = signal.SIGINT

#: From the one that yields to the others to the one that prevails where ranks have received different ones: what a
#: person or an administrator has said counts for more than what was arranged before.
BY_WEIGHT = (COME_BACK, INTERRUPT, END)


class StopSignals:
    """Remembers received signals.

    Nothing is done inside the handler: ranks get a signal at different moments, and one that starts to save in the
    middle of another's all-reduce waits for ever.

    Attributes:
        received: the weightiest signal so far, or None.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None

    def watch(self) -> None:
        """Start watching; replaces other handlers, such as Lightning's, which save and communicate inside."""
        if self.received != INTERRUPT:  # else the next Ctrl-C has been promised to end the process
            signal.signal(INTERRUPT, self._remember)
        for number in (COME_BACK, END):
            signal.signal(number, self._remember)

    def take(self) -> signal.Signals | None:
        """Return the received signal and clear it; the caller handles it."""
        received, self.received = self.received, None
        return received

    def _remember(self, number: int, _: FrameType | None) -> None:
        candidates = {signal.Signals(number), self.received} - {None}
        self.received = max(candidates, key=BY_WEIGHT.index)
        if number == INTERRUPT:
            signal.signal(INTERRUPT, signal.SIG_DFL)  # the system then ends the process, whatever it waits for
            if os.environ.get("LOCAL_RANK", "0") == "0":  # a terminal's Ctrl-C reaches all of its ranks
                print("\nstopping after this step; Ctrl-C again ends at once", file=sys.stderr, flush=True)


#: Of this process, which has one handler for each signal.
STOP_SIGNALS = StopSignals()

"""What a command says to Ctrl-C, from its first import on.

Importing this sets Python's hook for uncaught exceptions, so only commands do. It imports nothing that takes long:
files in launch/ import it first, and Ctrl-C is answered in one line while they import the rest.
"""

from __future__ import annotations

import sys
from types import TracebackType

from rfpp.extras import missing_extra


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What ends a command from outside, or before it begins: Ctrl-C, and a library that its file cannot import."""
    if issubclass(kind, KeyboardInterrupt):  # Python then ends by the signal, as shells expect
        print(f"interrupted: {str(error) or 'run the same command again'}", file=sys.stderr)
    elif missing := missing_extra(error):
        print(f"error: {missing}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _uncaught

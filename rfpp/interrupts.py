"""One-line messages for Ctrl-C and for libraries that are not installed.

Importing this sets Python's hook for uncaught exceptions, so only commands import it, before anything that takes long
to import.
"""

from __future__ import annotations

import sys
from types import TracebackType

from rfpp.extras import missing_extra


def _report(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print an exception that no command has caught."""
    if issubclass(kind, KeyboardInterrupt):  # Python then ends by the signal, as shells expect
        print(f"interrupted: {str(error) or 'run the same command again'}", file=sys.stderr)
    elif missing := missing_extra(error):
        print(f"error: {missing}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _report

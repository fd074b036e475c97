"""End a process that hangs."""

from __future__ import annotations

import faulthandler
import sys
from typing import Annotated, Any

import lightning as L
from pydantic import Field


class Watchdog(L.Callback):
    """Callback that prints all stacks and exits if no batch begins for some minutes.

    A rank may wait forever for another one, for a file server, or for a loader process. `minutes` must be longer than
    any checkpoint, compilation or batch takes.
    """

    def __init__(self, minutes: Annotated[float, Field(gt=0, le=1e6)]):
        self.seconds = 60 * minutes

    def _restart(self, *_: Any) -> None:
        faulthandler.dump_traceback_later(self.seconds, exit=True, file=sys.__stderr__)

    def _stop(self, *_: Any) -> None:
        faulthandler.cancel_dump_traceback_later()

    on_train_start = on_train_batch_start = on_validation_batch_start = _restart
    on_train_end = on_exception = _stop

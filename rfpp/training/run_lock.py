"""Lock a run's folder so that only one process writes to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from rfpp.errors import UserError


@contextmanager
def only_writer_of(run_dir: Path) -> Iterator[None]:
    """Lock a run's folder; the lock is released when the process ends.

    Raises:
        UserError: another process holds it.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    lock = FileLock(run_dir / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise UserError(
            f"{run_dir}: another process is training this run: wait until it has ended, or choose another run_dir"
        ) from error
    except NotImplementedError:  # a file system without locks
        yield
        return
    try:
        yield
    finally:
        lock.release()

"""A size-bounded cache folder for downloaded files, shared between processes."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock

from rfpp.errors import UserError


@dataclass(frozen=True)
class ShardCache:
    """Least-recently-used cache, which several machines may share.

    Files are named by their content hash, so entries never become stale. Removing an open file does not disturb its
    readers; its space is freed when the last one closes it.
    """

    folder: str | Path
    gigabytes: int | float

    def open(self, name: str, size: int, fetch: Callable[[Path], None]) -> int:
        """Return a file descriptor of the file `name`; if it is not cached, `fetch` writes it to a given path.

        If several processes request a file, one of them fetches it.

        Raises:
            UserError: If the folder cannot be written or the file is larger than the cache; also whatever `fetch`
                raises.
        """
        if size > self.gigabytes * 1e9:
            raise UserError(
                f"{self.folder}: a file of {size} bytes does not fit: raise "
                f"datamodule.source.cache.gigabytes={self.gigabytes}"
            )
        path = Path(self.folder) / name
        try:
            if (descriptor := _open_complete(path, size)) is not None:
                return descriptor
            path.parent.mkdir(parents=True, exist_ok=True)
            # a few locks for all files: removing a lock file is unsafe while other processes wait for it
            with FileLock(path.with_name(f".{name[:2]}.lock")):
                if (descriptor := _open_complete(path, size)) is not None:
                    return descriptor
                partial = path.with_name(f".{name}.part")
                fetch(partial)
                descriptor = os.open(partial, os.O_RDONLY)
                os.replace(partial, path)
            self._remove_oldest()
        except OSError as error:
            raise UserError(
                f"{self.folder}: cannot be written ({error.strerror}): free space, lower "
                "datamodule.source.cache.gigabytes or choose another datamodule.source.cache.folder"
            ) from error
        return descriptor

    def _remove_oldest(self) -> None:
        with FileLock(Path(self.folder) / ".room.lock"):
            files = []
            for path in Path(self.folder).glob("[!.]*"):
                with suppress(FileNotFoundError):
                    files.append((path.stat(), path))
            total = sum(stat.st_size for stat, _ in files)
            for stat, path in sorted(files, key=lambda file: file[0].st_mtime_ns):
                if total <= self.gigabytes * 1e9:
                    break
                path.unlink(missing_ok=True)
                total -= stat.st_size


def _open_complete(path: Path, size: int) -> int | None:
    """Open a cached file and mark it as used; return None if it is missing or incomplete."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    if os.fstat(descriptor).st_size != size:  # left by a crash of the machine
        os.close(descriptor)
        path.unlink(missing_ok=True)
        return None
    with suppress(FileNotFoundError):  # another process removed it; the open descriptor stays valid
        os.utime(path)
    return descriptor

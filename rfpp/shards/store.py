"""Storage of a data set: a local folder or a URL."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import fsspec

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import ListedShard

Result = TypeVar("Result")

#: Seconds to wait before a failed transfer is tried again.
_PAUSES = (0.5, 2.0, 8.0)
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class FolderStore:
    """A folder of this machine."""

    root: Path

    def read(self, file: str) -> bytes:
        """Read a small file without a known size or hash. Raises OSError."""
        return (self.root / file).read_bytes()

    def open_tar(self, shard: ListedShard) -> int:
        """A file descriptor. Raises ShardError naming the tar when it is missing or has another size."""
        path = shard.require_intact_file(self.root)
        try:
            return os.open(path, os.O_RDONLY)
        except OSError as error:
            raise ShardError(f"{path}: cannot be opened ({error.strerror}): check its permissions") from error

    def read_index(self, shard: ListedShard) -> bytes:
        """Raises ShardError naming the index when it cannot be read."""
        path = self.root / shard.index_file
        try:
            return path.read_bytes()
        except OSError as error:
            raise ShardError(f"{path}: the index cannot be read ({error.strerror}): {shard.remedy}") from error


@dataclass(frozen=True)
class RemoteStore:
    """A folder behind a URL of any kind that fsspec knows, read through a cache.

    Methods are those of `FolderStore`; what cannot be fetched in several attempts is a UserError that names its URL,
    what keeps arriving in another size a ShardError.
    """

    root: str
    cache: ShardCache

    def read(self, file: str) -> bytes:
        return self._patiently(file, lambda files, path: files.cat_file(path))

    def open_tar(self, shard: ListedShard) -> int:
        return self._cached(shard.file, shard.sha256, shard.bytes)

    def read_index(self, shard: ListedShard) -> bytes:
        with open(self._cached(shard.index_file, shard.index_sha256, shard.index_bytes), "rb") as file:
            return file.read()

    def _cached(self, file: str, sha256: str, size: int) -> int:
        def fetch(target: Path) -> None:
            def transfer(files: Any, path: str) -> None:
                files.get_file(path, str(target))
                if (received := target.stat().st_size) != size:
                    raise _TruncatedError(f"truncated or altered: {received} bytes, the manifest says {size}")

            try:
                self._patiently(file, transfer)
            except FileNotFoundError:
                raise ShardError(f"{self.root}/{file}: the file is missing: upload it, or set data.root") from None

        return self.cache.open(f"{sha256[:20]}-{file}", size, fetch)

    def _patiently(self, file: str, transfer: Callable[[Any, str], Result]) -> Result:
        url = f"{self.root}/{file}"
        try:
            files, path = fsspec.core.url_to_fs(url)
        except ImportError as error:
            raise MissingDependencyError(f"{url}: {error}") from error
        except ValueError as error:
            raise UserError(f"{url}: {error}: set data.root to a folder or to a URL that fsspec knows") from error
        pauses = iter(_PAUSES)
        while True:
            try:
                return transfer(files, path)
            except FileNotFoundError:
                raise
            except Exception as error:  # every kind of server has errors of its own
                if isinstance(error, OSError) and (error.filename or error.errno in _NO_SPACE):
                    raise  # of this machine's disk
                if (pause := next(pauses, None)) is None:
                    kind = ShardError if isinstance(error, _TruncatedError) else UserError
                    reason = " ".join(str(error).split()) or type(error).__name__
                    raise kind(
                        f"{url}: cannot be fetched after {len(_PAUSES) + 1} attempts ({reason}): check the address, "
                        "the network and the server"
                    ) from error
                time.sleep(pause)


class _TruncatedError(Exception):
    """A download was truncated or delivered a different file."""


Store = FolderStore | RemoteStore


def open_store(root: str | Path, cache: ShardCache | None = None) -> Store:
    """The data set's folder at a path or a URL. Raises UserError when a URL comes without a cache to fetch to."""
    if "://" not in str(root):
        return FolderStore(Path(root))
    if cache is None:
        raise UserError(f"{root}: a data set behind a URL needs a cache: set datamodule.cache")
    return RemoteStore(str(root).rstrip("/"), cache)

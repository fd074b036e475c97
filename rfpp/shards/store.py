"""Storage of a data set: a local folder or a URL."""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import fsspec
from fsspec.callbacks import Callback

from rfpp.errors import MissingDependencyError, ShardError, UserError
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import ListedShard, Shard

Result = TypeVar("Result")
#: Folder or URL of a data set.
Root = str | Path

#: What to run if something is missing or damaged.
REMEDY = "run launch/generate.py again with the same experiment"

#: Seconds to wait before repeating a failed transfer.
_PAUSES = (0.5, 2.0, 8.0)
#: Bytes per second that a server must send, after seconds in which it may be slower.
_MIN_RATE, _GRACE = 50_000, 20.0
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT)
#: Limit of manifests and indices in bytes.
_MAX_BYTES = 2**28


@dataclass(frozen=True)
class FolderStore:
    """A folder on this machine."""

    root: Path

    def read(self, file: str) -> bytes:
        """Read a small file without a known size or hash. Raises OSError."""
        return _content(self.root / file)

    def require(self, shard: Shard) -> Path:
        """Return the tar's path. Raises ShardError if the tar is missing or has another size."""
        path = self.root / shard.file
        if not path.is_file():
            raise ShardError(f"{path}: the shard is missing: {self.remedy(shard)}")
        if (size := path.stat().st_size) != shard.bytes:
            raise ShardError(
                f"{path}: truncated or altered ({size} bytes, the manifest says {shard.bytes}): {self.remedy(shard)}"
            )
        return path

    def open_tar(self, shard: Shard) -> int:
        """Return a file descriptor of the tar. Raises ShardError if it is missing or has another size."""
        path = self.require(shard)
        try:
            return os.open(path, os.O_RDONLY)
        except OSError as error:
            raise ShardError(f"{path}: cannot be opened ({error.strerror}): check its permissions") from error

    def read_index(self, shard: ListedShard) -> bytes:
        """Read the index of a shard. Raises ShardError if it is missing."""
        path = self.root / shard.index_file
        try:
            return _content(path)
        except OSError as error:
            raise ShardError(f"{path}: the index cannot be read ({error.strerror}): {self.remedy(shard)}") from error

    def remedy(self, shard: Shard) -> str:
        """Say how to replace a damaged shard."""
        return f"delete {shard.file} and {shard.index_file}, and {REMEDY}"


@dataclass(frozen=True)
class RemoteStore:
    """A folder behind any URL that fsspec supports, read through a cache.

    The methods are those of `FolderStore`. A file that cannot be fetched in several attempts raises UserError naming
    its URL; a file that repeatedly arrives in another size raises ShardError.
    """

    root: str
    cache: ShardCache

    def read(self, file: str) -> bytes:
        with TemporaryDirectory() as folder:
            target = Path(folder) / file
            self._with_retries(file, lambda files, path: files.get_file(path, str(target), callback=_MinimumRate()))
            return target.read_bytes()

    def require(self, shard: Shard) -> None:
        """Do nothing: remote files are checked when they are fetched."""

    def open_tar(self, shard: Shard) -> int:
        return self._cached(shard.file, shard.sha256, shard.bytes)

    def read_index(self, shard: ListedShard) -> bytes:
        with open(self._cached(shard.index_file, shard.index_sha256, shard.index_bytes), "rb") as file:
            return file.read()

    def remedy(self, shard: Shard) -> str:
        return (
            f"delete *-{shard.file} and *-{shard.index_file} in datamodule.source.cache.folder, or repair them at "
            "their source"
        )

    def _cached(self, file: str, sha256: str, size: int) -> int:
        def fetch(target: Path) -> None:
            def transfer(files: Any, path: str) -> None:
                files.get_file(path, str(target), callback=_MinimumRate())
                if (received := target.stat().st_size) != size:
                    raise _TruncatedError(f"truncated or altered: {received} bytes, the manifest says {size}")

            try:
                self._with_retries(file, transfer)
            except FileNotFoundError:
                raise ShardError(f"{self.root}/{file}: the file is missing: upload it, or set data.root") from None

        return self.cache.open(f"{sha256[:20]}-{file}", size, fetch)

    def _with_retries(self, file: str, transfer: Callable[[Any, str], Result]) -> Result:
        url = f"{self.root}/{file}"
        try:
            files, path = fsspec.core.url_to_fs(url, **_time_limits(url))
        except ImportError as error:
            raise MissingDependencyError(f"{url}: {error}") from error
        except ValueError as error:
            raise UserError(f"{url}: {error}: set data.root to a folder or to a URL that fsspec supports") from error
        pauses = iter(_PAUSES)
        while True:
            try:
                return transfer(files, path)
            except FileNotFoundError:
                raise
            except Exception as error:  # each kind of server raises its own errors
                if isinstance(error, OSError) and (error.filename or error.errno in _NO_SPACE):
                    raise  # the local disk is at fault
                if (pause := next(pauses, None)) is None:
                    kind = ShardError if isinstance(error, _TruncatedError) else UserError
                    reason = " ".join(str(error).split()) or type(error).__name__
                    raise kind(
                        f"{url}: cannot be fetched after {len(_PAUSES) + 1} attempts ({reason}): check the address, "
                        "the network and the server"
                    ) from error
                time.sleep(pause)


class _TruncatedError(Exception):
    """A download of the wrong size."""


class _SlowError(Exception):
    """A download from a slow server."""


class _MinimumRate(Callback):
    """Raises _SlowError in a transfer that has become slower than _MIN_RATE on average."""

    def __init__(self) -> None:
        super().__init__()
        self._begin = time.monotonic()

    def relative_update(self, inc: int = 1) -> None:
        super().relative_update(inc)
        seconds = time.monotonic() - self._begin
        if seconds > _GRACE and self.value < _MIN_RATE * seconds:
            raise _SlowError(f"slower than {_MIN_RATE:,} bytes per second")


def _content(path: Path) -> bytes:
    """Read a regular file of bounded size. Raises OSError."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "not a regular file")
    if status.st_size > _MAX_BYTES:
        raise OSError(errno.EFBIG, f"more than {_MAX_BYTES:,} bytes")
    return path.read_bytes()


def _time_limits(url: str) -> dict[str, Any]:
    """Return fsspec's options that limit connecting and waiting for data; object stores have limits of their own."""
    if not url.startswith("http"):
        return {}
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(total=None, sock_connect=_GRACE, sock_read=_GRACE)
    return {"client_kwargs": {"timeout": timeout}}


Store = FolderStore | RemoteStore


def open_store(root: Root, cache: ShardCache | None = None) -> Store:
    """Return the store at a path or a URL. Raises UserError for a URL without a cache."""
    if "://" not in str(root):
        return FolderStore(Path(root))
    if cache is None:
        raise UserError(f"{root}: a data set behind a URL needs a cache: set datamodule.source.cache")
    return RemoteStore(str(root).rstrip("/"), cache)

"""Write shards atomically: first the tar, then its index."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.shards.index import SampleEntry, ShardIndex, index_file, to_json
from rfpp.shards.tar import END_OF_ARCHIVE


class ShardWriter:
    """Writes one tar under a temporary name; `commit` moves it into place and then writes its index.

    Args:
        root: Folder of the data set.
        file: Name of the tar.
        fingerprint: Identifies the settings of the samples.

    Raises:
        UserError: If the disk is full or the folder cannot be written; nothing is left behind.
    """

    def __init__(self, root: Path, file: str, fingerprint: str) -> None:
        self._root, self._name, self._fingerprint = root, file, fingerprint
        self._partial = root / f".{file}.part"
        self._digest, self._size = hashlib.sha256(), 0
        self._samples: list[SampleEntry] = []
        with self._reporting_full_disk():
            self._file = self._partial.open("wb")

    def add(self, key: str, blocks: bytes, **counts: int) -> None:
        """Append one packed sample (`rfpp.shards.tar.pack`) with its counts for `SampleEntry`."""
        digest = hashlib.sha256(blocks).hexdigest()
        self._samples.append(SampleEntry(key=key, offset=self._size, size=len(blocks), sha256=digest, **counts))
        self._append(blocks)

    def commit(self) -> ShardIndex:
        """Finish the tar, move it into place, then write its index."""
        self._append(END_OF_ARCHIVE)
        path = self._root / index_file(self._name)
        with self._reporting_full_disk():
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            path.unlink(missing_ok=True)  # never an old index beside a new tar
            os.replace(self._partial, self._root / self._name)
        index = ShardIndex(
            file=self._name,
            bytes=self._size,
            sha256=self._digest.hexdigest(),
            fingerprint=self._fingerprint,
            samples=tuple(self._samples),
        )
        write_atomically(path, index.to_bytes())
        return index

    def discard(self) -> None:
        """Delete an unfinished shard."""
        with suppress(OSError):  # on a full disk even closing fails
            self._file.close()
        self._partial.unlink(missing_ok=True)

    def _append(self, data: bytes) -> None:
        with self._reporting_full_disk():
            self._file.write(data)
        self._digest.update(data)
        self._size += len(data)

    @contextmanager
    def _reporting_full_disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if hasattr(self, "_file"):
                self.discard()
            raise UserError(
                f"{self._root / self._name}: cannot be written ({error.strerror}): free space or choose another "
                "data.root, then run the same command again (finished shards are kept)"
            ) from error


def write_json(path: Path, content: Any) -> None:
    """Write compact, sorted JSON atomically: equal content gives equal bytes. Raises UserError (full disk)."""
    write_atomically(path, to_json(content))

"""Write shards atomically: first the tar, then its index."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rfpp.errors import UserError
from rfpp.files import write_atomically
from rfpp.shards.index import SampleEntry, ShardIndex, index_file, to_json
from rfpp.shards.job import SampleBlocks
from rfpp.shards.tar import END_OF_ARCHIVE


def write_shard(root: Path, file: str, fingerprint: str, samples: Iterable[tuple[str, SampleBlocks]]) -> ShardIndex:
    """Write a tar under a temporary name, move it into place, then write its index.

    Raises:
        UserError: If the disk is full or the folder cannot be written; nothing is left behind.
    """
    partial, path, digest = root / f".{file}.part", root / index_file(file), hashlib.sha256()
    entries: list[SampleEntry] = []

    def blocks() -> Iterator[bytes]:
        offset = 0
        for key, made in samples:
            counts = {name: value for name, value in vars(made).items() if name != "blocks"}
            sha256, size = hashlib.sha256(made.blocks).hexdigest(), len(made.blocks)
            entries.append(SampleEntry(key=key, offset=offset, size=size, sha256=sha256, **counts))
            offset += size
            yield made.blocks
        yield END_OF_ARCHIVE

    try:
        with partial.open("wb") as tar:
            for data in blocks():
                tar.write(data)
                digest.update(data)
            tar.flush()
            os.fsync(tar.fileno())
        path.unlink(missing_ok=True)  # never an old index beside a new tar
        os.replace(partial, root / file)
    except OSError as error:
        raise UserError(
            f"{root / file}: cannot be written ({error.strerror}): free space or choose another data.root, then run "
            "the same command again (finished shards are kept)"
        ) from error
    finally:
        partial.unlink(missing_ok=True)
    size, sha256 = (root / file).stat().st_size, digest.hexdigest()
    index = ShardIndex(file=file, bytes=size, sha256=sha256, fingerprint=fingerprint, samples=tuple(entries))
    write_atomically(path, index.to_bytes())
    return index


def write_json(path: Path, content: Any) -> None:
    """Write compact, sorted JSON atomically: equal content gives equal bytes. Raises UserError (full disk)."""
    write_atomically(path, to_json(content))

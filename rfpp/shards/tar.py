"""Pack and unpack samples as tar blocks; equal members give equal bytes."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping

from webdataset import TarWriter

#: The end of every tar file.
END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Return the tar blocks of files `{key}.{member}`, sorted, without the end of the archive."""
    blocks = io.BytesIO()
    with TarWriter(blocks, user="", group="", mode=0o644, encoder=False, mtime=0) as archive:
        archive.write({"__key__": key, **members})
    size = sum(tarfile.BLOCKSIZE + len(data) + -len(data) % tarfile.BLOCKSIZE for data in members.values())
    return blocks.getvalue()[:size]


def unpack(blocks: bytes) -> tuple[str, dict[str, bytes]]:
    """Return the key and the members in one sample's blocks. Raises tarfile.TarError for invalid blocks."""
    members: dict[str, bytes] = {}
    key = ""
    try:
        with tarfile.open(fileobj=io.BytesIO(blocks)) as archive:
            for entry in archive:
                if not entry.isfile() or entry.issparse():
                    raise tarfile.TarError(f"{entry.name} is not a plain file")
                key, _, member = entry.name.partition(".")
                members[member] = archive.extractfile(entry).read()
    except (RecursionError, ValueError, OverflowError) as error:  # of tarfile, for absurd headers
        raise tarfile.TarError(f"its header is damaged: {error}") from None
    return key, members

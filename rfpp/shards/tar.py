"""Pack and unpack samples as tar blocks; equal members give equal bytes."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Mapping

#: The end of every tar file.
END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)


def pack(key: str, members: Mapping[str, bytes]) -> bytes:
    """Return the tar blocks of files `{key}.{member}` in the given order, without the end of the archive."""
    blocks = io.BytesIO()
    for member, data in members.items():
        entry = tarfile.TarInfo(f"{key}.{member}")
        entry.size = len(data)
        entry.mode = 0o644
        blocks.write(entry.tobuf(tarfile.USTAR_FORMAT))
        blocks.write(data)
        blocks.write(bytes(-len(data) % tarfile.BLOCKSIZE))
    return blocks.getvalue()


def unpack(blocks: bytes) -> tuple[str, dict[str, bytes]]:
    """Return the key and the members in one sample's blocks. Raises tarfile.TarError for invalid blocks."""
    members: dict[str, bytes] = {}
    key = ""
    with tarfile.open(fileobj=io.BytesIO(blocks)) as archive:
        for entry in archive:
            if not entry.isfile():
                raise tarfile.TarError(f"{entry.name} is not a plain file")
            key, _, member = entry.name.partition(".")
            members[member] = archive.extractfile(entry).read()
    return key, members

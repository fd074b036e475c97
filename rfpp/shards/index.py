"""Shard indices: offset, size and hash of every sample."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tarfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rfpp.errors import ShardError
from rfpp.files import is_plain_name
from rfpp.shards import tar

#: What to run when something is missing or damaged.
REMEDY = "run launch/generate.py again with the same experiment"


class SampleEntry(NamedTuple):
    """Position of a sample in its tar, its hash, and its contents.

    `scene_redraws` counts scenes that were drawn and rejected before this one, `empty_views` and `unlit_views`
    cameras, because they saw too little surface or too little light.
    """

    key: str
    offset: int
    size: int
    sha256: str
    triangles: int
    objects: int
    scene_redraws: int
    empty_views: int
    unlit_views: int


@dataclass(frozen=True)
class Shard:
    """One finished tar file: its name in the data set's folder, size and hash.

    `fingerprint` identifies the settings that it was made with.
    """

    file: str
    bytes: int
    sha256: str
    fingerprint: str

    def __post_init__(self) -> None:
        """Raises ValueError for paths outside the data set: indices and manifests may be untrusted."""
        if not (is_plain_name(self.file) and self.file.endswith(".tar")):
            raise ValueError(f"{self.file!r} is not the name of a shard")
        require_hash(self.sha256)
        require_count(self.bytes)

    @property
    def index_file(self) -> str:
        """The name of its index."""
        return index_file(self.file)

    def require_intact_file(self, root: Path) -> Path:
        """The tar's path. Raises ShardError naming the shard when it is missing or has another size."""
        path = root / self.file
        if not path.is_file():
            raise ShardError(f"{path}: the shard is missing: {self.remedy}")
        size = path.stat().st_size
        if size != self.bytes:
            raise ShardError(
                f"{path}: truncated or altered ({size} bytes, the manifest says {self.bytes}): {self.remedy}"
            )
        return path

    def blocks(self, root: Path | str, descriptor: int, entry: SampleEntry) -> bytes:
        """The tar blocks of a sample, from the open tar. Raises ShardError if they do not have the recorded sha256."""
        blocks = os.pread(descriptor, entry.size, entry.offset)
        if hashlib.sha256(blocks).hexdigest() != entry.sha256:
            raise self.damaged(root, entry.key, "does not have the recorded sha256")
        return blocks

    def members(self, root: Path | str, descriptor: int, entry: SampleEntry) -> dict[str, bytes]:
        """The files of a sample, from the open tar. Raises ShardError naming shard and sample, if it is damaged."""
        try:
            key, members = tar.unpack(self.blocks(root, descriptor, entry))
        except tarfile.TarError as error:
            raise self.damaged(root, entry.key, f"is not a tar entry ({error})") from error
        if key != entry.key:
            raise self.damaged(root, entry.key, f"is called {key} in the tar")
        return members

    def damaged(self, root: Path | str, key: str, why: str) -> ShardError:
        """The error to raise when the sample `key` cannot be used."""
        return ShardError(f"{root}/{self.file}: sample {key} {why}: {self.remedy_at(root)}")

    @property
    def remedy(self) -> str:
        return f"delete {self.file} and {self.index_file}, and {REMEDY}"

    def remedy_at(self, root: Path | str) -> str:
        """How to fix a damaged shard in the folder or at the URL `root`."""
        if isinstance(root, Path):
            return self.remedy
        return (
            f"delete *-{self.file} and *-{self.index_file} in datamodule.cache.folder, or repair them at their source"
        )


@dataclass(frozen=True)
class ShardIndex(Shard):
    """A shard with its samples in order."""

    samples: tuple[SampleEntry, ...]

    @classmethod
    def from_bytes(cls, text: bytes) -> ShardIndex:
        """The inverse of `to_bytes`. Raises ValueError, KeyError, TypeError or AttributeError on anything else."""
        content = json.loads(text)
        return cls(**{**content, "samples": tuple(SampleEntry(*row) for row in content["samples"])})

    def __post_init__(self) -> None:
        super().__post_init__()
        for entry in self.samples:
            if not is_plain_name(entry.key):
                raise ValueError(f"{entry.key!r} is not the key of a sample")
            require_hash(entry.sha256)
            require_count(*entry[1:3], *entry[4:])
            if entry.offset + entry.size > self.bytes:
                raise ValueError(f"sample {entry.key} ends behind its shard")

    def to_bytes(self) -> bytes:
        """The content of the index file."""
        return to_json({**asdict(self), "samples": [list(entry) for entry in self.samples]})


@dataclass(frozen=True)
class ListedShard(Shard):
    """A shard in the manifest: how many samples it has, and its index by size and hash."""

    samples: int
    index_bytes: int
    index_sha256: str

    def __post_init__(self) -> None:
        super().__post_init__()
        require_hash(self.index_sha256)
        require_count(self.samples, self.index_bytes)

    @classmethod
    def of(cls, index: ShardIndex) -> ListedShard:
        text = index.to_bytes()
        return cls(
            index.file,
            index.bytes,
            index.sha256,
            index.fingerprint,
            samples=len(index.samples),
            index_bytes=len(text),
            index_sha256=hashlib.sha256(text).hexdigest(),
        )


def require_hash(text: object) -> None:
    """Raises ValueError unless it is a sha256 in hexadecimal."""
    if not (isinstance(text, str) and re.fullmatch(r"[0-9a-f]{64}", text)):
        raise ValueError(f"{text!r} is not a sha256")


def require_count(*numbers: object) -> None:
    """Raises ValueError unless it is a non-negative integer."""
    for number in numbers:
        if type(number) is not int or not 0 <= number < 2**63:
            raise ValueError(f"{number!r} is not a number of bytes or things")


def index_file(file: str) -> str:
    """The name of the index beside the shard `file`."""
    return Path(file).with_suffix(".json").name


def load_index(root: Path, file: str) -> ShardIndex | None:
    """The shard as its index describes it, or None when there is no index or no tar of the size it states."""
    try:
        index = ShardIndex.from_bytes((root / index_file(file)).read_bytes())
        index.require_intact_file(root)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ShardError):
        return None
    return index


def to_json(content: Any) -> bytes:
    """Compact, sorted JSON: equal content, equal bytes."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode() + b"\n"

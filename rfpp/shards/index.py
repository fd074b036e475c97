"""The index beside each shard: what its tar holds, sample by sample."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rfpp.errors import ShardError

#: What to run when something is missing or damaged.
REMEDY = "run launch/generate.py again with the same experiment"


class SampleEntry(NamedTuple):
    """Where one sample lies in its tar, what its bytes hash to, and what it holds.

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

    def damaged(self, root: Path, key: str, why: str) -> ShardError:
        """The error to raise when the sample `key` cannot be used."""
        return ShardError(f"{root / self.file}: sample {key} {why}: {self.remedy}")

    @property
    def remedy(self) -> str:
        return f"delete {self.file} and {self.index_file}, and {REMEDY}"


@dataclass(frozen=True)
class ShardIndex(Shard):
    """A shard with its samples in order."""

    samples: tuple[SampleEntry, ...]

    @classmethod
    def from_bytes(cls, text: bytes) -> ShardIndex:
        """The inverse of `to_bytes`. Raises ValueError, KeyError or TypeError on anything else."""
        content = json.loads(text)
        return cls(**{**content, "samples": tuple(SampleEntry(*row) for row in content["samples"])})

    def to_bytes(self) -> bytes:
        """The content of the index file."""
        return to_json({**asdict(self), "samples": [list(entry) for entry in self.samples]})


def index_file(file: str) -> str:
    """The name of the index beside the shard `file`."""
    return Path(file).with_suffix(".json").name


def load_index(root: Path, file: str) -> ShardIndex | None:
    """The shard as its index describes it, or None when there is no index or no tar of the size it states."""
    try:
        index = ShardIndex.from_bytes((root / index_file(file)).read_bytes())
        index.require_intact_file(root)
    except (OSError, ValueError, KeyError, TypeError, ShardError):
        return None
    return index


def to_json(content: Any) -> bytes:
    """Compact, sorted JSON: equal content, equal bytes."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode() + b"\n"

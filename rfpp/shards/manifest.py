"""What a data set on disk consists of: an index beside each shard, and the manifest that joins them all."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rfpp.errors import ShardError
from rfpp.shards.sample import SCHEMA_VERSION

MANIFEST_FILE = "manifest.json"

#: What to run when something is missing or damaged.
REMEDY = "run launch/generate.py again with the same experiment"


class SampleEntry(NamedTuple):
    """Where one sample lies in its tar, what its bytes hash to, and what it holds.

    `scene_redraws` counts scenes that were drawn and rejected before this one, `camera_redraws` cameras.
    """

    key: str
    offset: int
    size: int
    sha256: str
    triangles: int
    objects: int
    scene_redraws: int
    camera_redraws: int


@dataclass(frozen=True)
class Shard:
    """One finished tar file: its name in the data set's folder, size, hash and samples in order.

    `fingerprint` identifies the settings that it was made with.
    """

    file: str
    bytes: int
    sha256: str
    fingerprint: str
    samples: tuple[SampleEntry, ...]

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Shard:
        return cls(**{**content, "samples": tuple(SampleEntry(*row) for row in content["samples"])})

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "samples": [list(entry) for entry in self.samples]}

    def require_intact_file(self, root: Path) -> Path:
        """The tar's path. Raises ShardError naming the shard when it is missing or has another size."""
        path = root / self.file
        if not path.is_file():
            raise ShardError(f"{path}: the shard is missing: {self._remedy(root)}")
        size = path.stat().st_size
        if size != self.bytes:
            raise ShardError(
                f"{path}: truncated or altered ({size} bytes, the manifest says {self.bytes}): {self._remedy(root)}"
            )
        return path

    def damaged(self, root: Path, key: str, why: str) -> ShardError:
        """The error to raise when the sample `key` cannot be used."""
        return ShardError(f"{root / self.file}: sample {key} {why}: {self._remedy(root)}")

    def _remedy(self, root: Path) -> str:
        return f"delete {self.file} and {index_path(root, self.file).name}, and {REMEDY}"


class Manifest:
    """A complete data set.

    Attributes:
        root: its folder.
        name: its name.
        settings: everything its content depends on.
        hash: sha256 of the manifest file; as the manifest holds every shard's hash, it identifies the data.
        counts: "scenes", "images", "triangles", "bytes", "scene_redraws", "camera_redraws" over all splits.
    """

    def __init__(self, root: Path, content: dict[str, Any], digest: str) -> None:
        self.root = root
        self.name: str = content["name"]
        self.settings: dict[str, Any] = content["settings"]
        self.counts: dict[str, int] = content["counts"]
        self.hash = digest
        self._splits = {
            split: tuple(Shard.from_json(shard) for shard in shards) for split, shards in content["splits"].items()
        }

    @classmethod
    def load(cls, root: str | Path) -> Manifest:
        """Read `root`/manifest.json. Raises ShardError: absent, unreadable, or of another schema version."""
        path = Path(root) / MANIFEST_FILE
        try:
            text = path.read_bytes()
        except OSError:
            raise ShardError(f"{path}: there is no finished data set here: {REMEDY}, or set data.root") from None
        try:
            content = json.loads(text)
            version = content["schema_version"]
            if version == SCHEMA_VERSION:
                return cls(Path(root), content, hashlib.sha256(text).hexdigest())
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ShardError(f"{path}: not a data set manifest ({error!r}): delete it and {REMEDY}") from error
        raise ShardError(
            f"{path}: schema version {version}, this code reads {SCHEMA_VERSION}: generate the data again in a new "
            "folder (data.name), or use the matching code"
        )

    def shards(self, split: str) -> tuple[Shard, ...]:
        """The shards of a split. Raises ShardError naming the splits there are."""
        if split not in self._splits:
            raise ShardError(f"{self.root / MANIFEST_FILE}: no split '{split}': choose from {', '.join(self._splits)}")
        return self._splits[split]

    def samples(self, split: str) -> list[SampleEntry]:
        """The samples of a split in order of their index."""
        return [entry for shard in self.shards(split) for entry in shard.samples]

    @property
    def splits(self) -> tuple[str, ...]:
        return tuple(self._splits)


def manifest_json(name: str, settings: dict[str, Any], views: int, splits: dict[str, list[Shard]]) -> dict[str, Any]:
    """The content of manifest.json; a function of the data alone, so that equal data have equal hashes."""
    shards = [shard for of_split in splits.values() for shard in of_split]
    entries = [entry for shard in shards for entry in shard.samples]
    counts = {
        "scenes": len(entries),
        "images": len(entries) * views,
        "triangles": sum(e.triangles for e in entries),
        "bytes": sum(shard.bytes for shard in shards),
        "scene_redraws": sum(e.scene_redraws for e in entries),
        "camera_redraws": sum(e.camera_redraws for e in entries),
    }
    return {
        "schema_version": SCHEMA_VERSION,
        "name": name,
        "settings": settings,
        "counts": counts,
        "sample_columns": list(SampleEntry._fields),
        "splits": {split: [shard.to_json() for shard in of_split] for split, of_split in splits.items()},
    }


def index_path(root: Path, file: str) -> Path:
    """The index file beside a shard."""
    return (root / file).with_suffix(".json")


def load_index(root: Path, file: str) -> Shard | None:
    """The shard as its index describes it, or None when there is no index or no tar of the size it states."""
    try:
        shard = Shard.from_json(json.loads(index_path(root, file).read_bytes()))
        shard.require_intact_file(root)
    except (OSError, ValueError, KeyError, TypeError, ShardError):
        return None
    return shard

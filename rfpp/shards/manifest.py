"""Manifests of complete data sets."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rfpp.errors import ShardError
from rfpp.files import is_plain_name
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import REMEDY, ListedShard, SampleEntry, ShardIndex
from rfpp.shards.sample import SCHEMA_VERSION
from rfpp.shards.store import Store, open_store

MANIFEST_FILE = "manifest.json"

#: Columns of the index that the manifest adds up.
_COUNTED = ("triangles", "scene_redraws", "empty_views", "unlit_views")


class Manifest:
    """A complete data set. Samples are listed in the shards' indices, which are read on demand.

    Attributes:
        store: where it lies.
        name: its name.
        settings: everything its content depends on.
        hash: sha256 of the manifest file; as the manifest holds every shard's hash, it identifies the data.
        counts: "scenes", "images", "triangles", "bytes", "scene_redraws", "empty_views", "unlit_views" over all splits.
    """

    def __init__(self, store: Store, content: dict[str, Any], digest: str) -> None:
        self.store = store
        self.name: str = content["name"]
        if not is_plain_name(self.name):  # results are written to a folder of that name
            raise ValueError(f"{self.name!r} is not the name of a data set")
        self.settings: dict[str, Any] = content["settings"]
        self.counts: dict[str, int] = content["counts"]
        self.hash = digest
        self._splits = {
            split: tuple(ListedShard(**shard) for shard in shards) for split, shards in content["splits"].items()
        }

    @classmethod
    def load(cls, root: str | Path, cache: ShardCache | None = None) -> Manifest:
        """Read the manifest of the data set in the folder `root`, or behind that URL.

        Raises:
            ShardError: absent, unreadable, or of another schema version.
            UserError: the server cannot be reached, or a URL comes without a cache.
        """
        store = open_store(root, cache)
        path = f"{store.root}/{MANIFEST_FILE}"
        try:
            text = store.read(MANIFEST_FILE)
        except OSError:
            raise ShardError(f"{path}: there is no finished data set here: {REMEDY}, or set data.root") from None
        try:
            content = json.loads(text)
            version = content["schema_version"]
            if version == SCHEMA_VERSION:
                return cls(store, content, hashlib.sha256(text).hexdigest())
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ShardError(f"{path}: not a data set manifest ({error!r}): delete it and {REMEDY}") from error
        raise ShardError(
            f"{path}: schema version {version}, this code reads {SCHEMA_VERSION}: generate the data again in a new "
            "folder (data.name), or use the matching code"
        )

    def shards(self, split: str) -> tuple[ListedShard, ...]:
        """The shards of a split. Raises ShardError naming the splits there are."""
        if split not in self._splits:
            raise ShardError(f"{self.root}/{MANIFEST_FILE}: no split '{split}': choose from {', '.join(self._splits)}")
        return self._splits[split]

    def index(self, shard: ListedShard) -> ShardIndex:
        """The index of a shard. Raises ShardError naming the file: missing, or not the one that was listed."""
        text = self.store.read_index(shard)
        if hashlib.sha256(text).hexdigest() != shard.index_sha256:
            raise ShardError(
                f"{self.root}/{shard.index_file}: the index does not have the sha256 in the manifest: "
                f"{shard.remedy_at(self.root)}"
            )
        try:
            index = ShardIndex.from_bytes(text)
            if len(index.samples) != shard.samples:
                raise ValueError(f"it lists {len(index.samples)} samples, the manifest says {shard.samples}")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            why = f"{self.root}/{shard.index_file}: not the index of a shard ({error})"
            raise ShardError(f"{why}: {shard.remedy_at(self.root)}") from error
        return index

    def samples(self, split: str) -> list[SampleEntry]:
        """The samples of a split in order of their index; reads the index of every shard."""
        return [entry for shard in self.shards(split) for entry in self.index(shard).samples]

    @property
    def root(self) -> str | Path:
        """The data set's folder or URL."""
        return self.store.root

    @property
    def splits(self) -> tuple[str, ...]:
        return tuple(self._splits)


def manifest_json(
    name: str, settings: Mapping[str, Any], views: int, splits: Mapping[str, Iterable[ShardIndex]]
) -> dict[str, Any]:
    """The content of manifest.json; a function of the data alone, so that equal data have equal hashes."""
    listed: dict[str, list[dict[str, Any]]] = {}
    counts = dict.fromkeys(("scenes", "images", "bytes", *_COUNTED), 0)
    for split, indices in splits.items():
        listed[split] = []
        for index in indices:
            listed[split].append(asdict(ListedShard.of(index)))
            counts["scenes"] += len(index.samples)
            counts["images"] += len(index.samples) * views
            counts["bytes"] += index.bytes
            for column in _COUNTED:
                counts[column] += sum(getattr(entry, column) for entry in index.samples)
    return {
        "schema_version": SCHEMA_VERSION,
        "name": name,
        "settings": settings,
        "counts": counts,
        "splits": listed,
    }

"""Manifests of complete data sets."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from rfpp.errors import ShardError
from rfpp.scene.spec import first_problem
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import ListedShard, PlainName, Record, SampleEntry, ShardIndex
from rfpp.shards.sample import SCHEMA_VERSION
from rfpp.shards.store import REMEDY, Root, open_store
from rfpp.shards.stored_shard import StoredShard

MANIFEST_FILE = "manifest.json"

#: Columns of the index that the manifest adds up.
_COUNTED = ("triangles", "scene_redraws", "empty_views", "unlit_views")


class _Content(Record):
    """Content of manifest.json."""

    schema_version: int
    name: PlainName  # results are written to a folder of that name
    settings: dict[str, Any]
    counts: dict[str, int]
    splits: dict[str, tuple[ListedShard, ...]]


@dataclass(frozen=True)
class Manifest:
    """A complete data set, or several used as one. Samples are listed in the shards' indices, read on demand.

    Attributes:
        root: folder or URL, or several separated by commas.
        name: name of the data set, or several joined by "+".
        hash: sha256 of the manifest file, which identifies the data; for several data sets, a hash of their hashes.
        settings: everything the content depends on; for several data sets, by name.
        counts: "scenes", "images", "triangles", "bytes", "scene_redraws", "empty_views", "unlit_views" of all splits.
        splits: split → shards, of one data set after the other.
    """

    root: Root
    name: str
    hash: str
    settings: Mapping[str, Any]
    counts: Mapping[str, int]
    splits: Mapping[str, tuple[StoredShard, ...]]

    @classmethod
    def load(cls, root: Root | Sequence[Root], cache: ShardCache | None = None) -> Manifest:
        """Read the manifest of a data set, or of several to be used as one; one listed twice counts twice.

        Raises:
            ShardError: If a manifest is missing, unreadable or of another schema version, or image sizes differ.
            UserError: If a server cannot be reached, or a URL has no cache.
        """
        if not isinstance(root, Root):
            return _joined([cls.load(one, cache) for one in root])
        store = open_store(root, cache)
        path = f"{store.root}/{MANIFEST_FILE}"
        try:
            text = store.read(MANIFEST_FILE)
        except OSError:
            raise ShardError(f"{path}: there is no finished data set here: {REMEDY}, or set data.root") from None
        try:
            content = _Content.model_validate_json(text)
        except ValidationError as error:
            reason = first_problem(error)
            raise ShardError(f"{path}: not a data set manifest ({reason}): delete it and {REMEDY}") from error
        if content.schema_version != SCHEMA_VERSION:
            raise ShardError(
                f"{path}: schema version {content.schema_version}, this code reads {SCHEMA_VERSION}: generate the data "
                "again in a new folder (data.name)"
            )
        splits = {s: tuple(StoredShard(shard, store) for shard in shards) for s, shards in content.splits.items()}
        digest = hashlib.sha256(text).hexdigest()
        return cls(store.root, content.name, digest, content.settings, content.counts, splits)

    def shards(self, split: str) -> tuple[StoredShard, ...]:
        """Return the shards of a split. Raises ShardError listing the available splits."""
        if split not in self.splits:
            raise ShardError(f"{self.root}/{MANIFEST_FILE}: no split '{split}': choose from {', '.join(self.splits)}")
        return self.splits[split]

    def samples(self, split: str) -> list[SampleEntry]:
        """Return the samples of a split in order; reads the index of every shard."""
        return [entry for shard in self.shards(split) for entry in shard.index().samples]


def _joined(manifests: Sequence[Manifest]) -> Manifest:
    if not manifests:
        raise ShardError("datamodule.source.root names no data set: give a folder, or several")
    sizes = {str(m.root): m.settings["data"]["resolution"] for m in manifests}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{root}: {size}²" for root, size in sizes.items())
        raise ShardError(f"images differ in size ({found}): train on data sets of one resolution")
    common = [split for split in manifests[0].splits if all(split in m.splits for m in manifests)]
    return Manifest(
        root=",".join(sizes),
        name="+".join(m.name for m in manifests),
        hash=hashlib.sha256("".join(m.hash for m in manifests).encode()).hexdigest(),
        settings={m.name: m.settings for m in manifests},
        counts=dict(sum((Counter(m.counts) for m in manifests), Counter())),
        splits={split: tuple(shard for m in manifests for shard in m.splits[split]) for split in common},
    )


def manifest_json(
    name: str, settings: Mapping[str, Any], views: int, splits: Mapping[str, Iterable[ShardIndex]]
) -> dict[str, Any]:
    """Return the content of manifest.json, a function of the data alone: equal data have equal hashes."""
    indices = {split: tuple(of_split) for split, of_split in splits.items()}
    shards = [index for of_split in indices.values() for index in of_split]
    entries = [entry for index in shards for entry in index.samples]
    counts = {"scenes": len(entries), "images": len(entries) * views, "bytes": sum(index.bytes for index in shards)}
    return {
        "schema_version": SCHEMA_VERSION,
        "name": name,
        "settings": settings,
        "counts": counts | {column: sum(getattr(entry, column) for entry in entries) for column in _COUNTED},
        "splits": {
            split: [ListedShard.of(index).model_dump() for index in of_split] for split, of_split in indices.items()
        },
    }

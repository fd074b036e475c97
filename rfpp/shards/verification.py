"""Verify a data set: check every hash and decode every sample."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rfpp.errors import ShardError
from rfpp.reference.farm import RenderFarm
from rfpp.shards.index import SampleEntry
from rfpp.shards.manifest import Manifest
from rfpp.shards.sample import decode
from rfpp.shards.stored_shard import StoredShard
from rfpp.shards.tar import END_OF_ARCHIVE


def verify(root: Path, farm: RenderFarm, progress: Callable[[int, int], None]) -> list[str]:
    """Return all defects of a data set, one line each, in the order of its shards.

    Raises:
        ShardError: If the manifest cannot be read.
    """
    shards = [shard for of_split in Manifest.load(root).splits.values() for shard in of_split]
    problems: dict[StoredShard, list[str]] = {}
    progress(0, len(shards))
    for shard, found in farm.map(defects, shards, attempts=1):
        problems[shard] = [str(found)] if isinstance(found, Exception) else found
        progress(len(problems), len(shards))
    return [line for shard in shards for line in problems[shard]]


def defects(shard: StoredShard) -> list[str]:
    """Return the defects of a local shard."""
    try:
        index, path = shard.index(), shard.store.require(shard.listed)
    except ShardError as error:
        return [str(error)]
    remedy = shard.store.remedy(shard.listed)
    with path.open("rb") as file:
        problems = [p for entry in index.samples if (p := _problem(shard, file.fileno(), entry))]
        if not problems and sum(entry.size for entry in index.samples) + len(END_OF_ARCHIVE) != shard.listed.bytes:
            problems.append(f"{path}: its index does not list all samples: {remedy}")
        if not problems and hashlib.file_digest(file, "sha256").hexdigest() != shard.listed.sha256:
            problems.append(f"{path}: does not have the sha256 in the manifest: {remedy}")
    return problems


def _problem(shard: StoredShard, descriptor: int, entry: SampleEntry) -> str | None:
    try:
        sample = decode(entry.key, shard.members(descriptor, entry))
    except ShardError as error:
        return str(error)
    arrays = (sample.images, sample.triangles.positions, sample.triangles.normals, sample.c2w)
    if all(np.isfinite(array).all() for array in arrays):
        return None
    return str(shard.damage(entry.key, "holds NaN or infinity"))

"""Verify a data set: check every hash and decode every sample."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rfpp.errors import ShardError
from rfpp.reference.farm import RenderFarm
from rfpp.shards.index import SampleEntry
from rfpp.shards.manifest import ListedShard, Manifest
from rfpp.shards.sample import decode
from rfpp.shards.tar import END_OF_ARCHIVE


def verify(root: Path, farm: RenderFarm, progress: Callable[[int, int], None]) -> list[str]:
    """All defects of a data set, one line each, in the order of its shards.

    Args:
        progress: called with (shards looked at, shards in all).

    Raises:
        ShardError: the manifest itself cannot be read.
    """
    manifest = Manifest.load(root)
    shards = [(split, place) for split in manifest.splits for place in range(len(manifest.shards(split)))]
    problems: dict[tuple[str, int], list[str]] = {}
    progress(0, len(shards))
    for shard, found in farm.map(ShardCheck(root), shards, attempts=1):
        problems[shard] = [str(found)] if isinstance(found, Exception) else found
        progress(len(problems), len(shards))
    return [line for shard in shards for line in problems[shard]]


@dataclass(frozen=True)
class ShardCheck:
    """Checks one shard of a split; picklable."""

    root: Path

    def __call__(self, shard: tuple[str, int]) -> list[str]:
        """The shard's defects."""
        split, place = shard
        manifest = Manifest.load(self.root)
        listed = manifest.shards(split)[place]
        try:
            index = manifest.index(listed)
            path = listed.require_intact_file(self.root)
        except ShardError as error:
            return [str(error)]
        problems = [problem for entry in index.samples if (problem := self._problem(path, listed, entry))]
        if not problems and sum(entry.size for entry in index.samples) + len(END_OF_ARCHIVE) != listed.bytes:
            problems.append(f"{path}: its index does not list all that it holds: {listed.remedy}")
        if not problems and _sha256(path) != listed.sha256:
            problems.append(f"{path}: has another sha256 than in the manifest: {listed.remedy}")
        return problems

    def _problem(self, path: Path, shard: ListedShard, entry: SampleEntry) -> str | None:
        with path.open("rb") as file:
            try:
                sample = decode(entry.key, shard.members(self.root, file.fileno(), entry))
            except ShardError as error:
                return str(error)
        arrays = (sample.images, sample.triangles.positions, sample.triangles.normals, sample.c2w)
        if all(np.isfinite(array).all() for array in arrays):
            return None
        return str(shard.damaged(self.root, entry.key, "holds NaN or infinity"))


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

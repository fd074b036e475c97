"""A shard in its store: reads its index and its samples, checking hashes."""

from __future__ import annotations

import hashlib
import os
import tarfile
from dataclasses import dataclass
from typing import BinaryIO

from pydantic import ValidationError

from rfpp.errors import ShardError
from rfpp.scene.spec import first_problem
from rfpp.shards import tar
from rfpp.shards.index import ListedShard, SampleEntry, ShardIndex
from rfpp.shards.store import Store


@dataclass(frozen=True)
class StoredShard:
    """A shard of a manifest and the store with its files."""

    listed: ListedShard
    store: Store

    def index(self) -> ShardIndex:
        """Read the index. Raises ShardError if it is missing or is not the one listed."""
        text = self.store.read_index(self.listed)
        path, remedy = f"{self.store.root}/{self.listed.index_file}", self.store.remedy(self.listed)
        if hashlib.sha256(text).hexdigest() != self.listed.index_sha256:
            raise ShardError(f"{path}: the index does not have the sha256 in the manifest: {remedy}")
        try:
            index = ShardIndex.model_validate_json(text)
        except ValidationError as error:
            raise ShardError(f"{path}: not the index of a shard ({first_problem(error)}): {remedy}") from error
        if (count := len(index.samples)) != self.listed.samples:
            raise ShardError(f"{path}: lists {count} samples, the manifest says {self.listed.samples}: {remedy}")
        return index

    def open(self) -> int:
        """Return a file descriptor of the tar. Raises ShardError if it is missing or has another size."""
        return self.store.open_tar(self.listed)

    def open_verified(self) -> BinaryIO:
        """Open the tar after reading it once to check its hash. Raises ShardError if it is missing or damaged."""
        tar_file = os.fdopen(self.open(), "rb")
        if hashlib.file_digest(tar_file, "sha256").hexdigest() != self.listed.sha256:
            tar_file.close()
            path = f"{self.store.root}/{self.listed.file}"
            raise ShardError(f"{path}: does not have the sha256 in the manifest: {self.store.remedy(self.listed)}")
        tar_file.seek(0)
        return tar_file

    def members(self, descriptor: int, entry: SampleEntry) -> dict[str, bytes]:
        """Read the files of a sample from the open tar.

        Raises:
            ShardError: If the sample is damaged; names shard and sample.
        """
        blocks = os.pread(descriptor, entry.size, entry.offset)
        if hashlib.sha256(blocks).hexdigest() != entry.sha256:
            raise self.damage(entry.key, "does not have the recorded sha256")
        try:
            key, members = tar.unpack(blocks)
        except tarfile.TarError as error:
            raise self.damage(entry.key, f"is not a tar entry ({error})") from error
        if key != entry.key:
            raise self.damage(entry.key, f"is called {key} in the tar")
        return members

    def damage(self, key: str, problem: str) -> ShardError:
        """Return the error for a sample that cannot be used."""
        return ShardError(
            f"{self.store.root}/{self.listed.file}: sample {key} {problem}: {self.store.remedy(self.listed)}"
        )

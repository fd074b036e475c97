"""Random access to samples in plain tar files."""

from __future__ import annotations

import bisect
import os
from collections import OrderedDict
from collections.abc import Collection
from itertools import accumulate
from pathlib import Path

from torch.utils.data import Dataset

from rfpp.errors import ShardError
from rfpp.raycast.first_hit import CHANNELS
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import ListedShard, ShardIndex
from rfpp.shards.manifest import Manifest
from rfpp.shards.sample import SceneSample, ViewChoice, decode

#: Open shards per process; the one longest unused is closed first. A window of the shuffled order has fewer.
_MAX_OPEN = 32


class ShardSplit(Dataset):
    """The scenes of one split, by index.

    Reads only the bytes of the sample asked for. Picklable: every process opens the tars it touches itself.

    Args:
        root: folder or URL of the data set.
        split: e.g. "train", "train_newviews", "test".
        cache: for a URL.
        require_all: whether a missing shard, or one of the wrong size, is an error at construction already; of remote
            shards nothing is known before they are fetched.

    Raises:
        ShardError: no data set, no such split, a missing or truncated shard (at construction or when it is read), an
            index that is not the manifest's, or a sample whose bytes do not have the recorded sha256 (when it is
            read). Each names the file, the key and what to do.
        UserError: a server that cannot be reached.
    """

    def __init__(self, root: str | Path, split: str, cache: ShardCache | None = None, require_all: bool = True) -> None:
        self.manifest = Manifest.load(root, cache)
        self.split = split
        self._shards = self.manifest.shards(split)
        self._ends = list(accumulate(self.sizes))
        self._open: OrderedDict[str, tuple[ShardIndex, int]] = OrderedDict()
        self._triangles: dict[str, list[int]] = {}
        if require_all and isinstance(self.manifest.root, Path):
            for shard in self._shards:
                shard.require_intact_file(self.manifest.root)

    @property
    def sizes(self) -> list[int]:
        """Scenes in each shard."""
        return [shard.samples for shard in self._shards]

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: int) -> SceneSample:
        return self.read(index)

    def read(
        self,
        index: int,
        choose: ViewChoice | None = None,
        channels: Collection[str] = tuple(CHANNELS),
    ) -> SceneSample:
        """The scene, or the requested parts of it (see `rfpp.shards.sample.decode`)."""
        shard, position = self._locate(index)
        opened, descriptor = self._opened(shard)
        entry = opened.samples[position]
        return decode(entry.key, shard.members(self.manifest.root, descriptor, entry), choose, channels)

    def key(self, index: int) -> str:
        """The key of a sample, without reading it."""
        shard, position = self._locate(index)
        return self._opened(shard)[0].samples[position].key

    def triangles(self, index: int) -> int:
        """Number of triangles of a scene, from the shard's index, which is read once."""
        shard, position = self._locate(index)
        if shard.file not in self._triangles:
            self._triangles[shard.file] = [entry.triangles for entry in self.manifest.index(shard).samples]
        return self._triangles[shard.file][position]

    def close(self) -> None:
        """Close all files; they are opened again when needed."""
        while self._open:
            os.close(self._open.popitem()[1][1])

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_open": OrderedDict()}

    def __del__(self) -> None:
        if hasattr(self, "_open"):
            self.close()

    def _locate(self, index: int) -> tuple[ListedShard, int]:
        """The shard of a sample, and its number in it."""
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)} in split '{self.split}'")
        number = bisect.bisect_right(self._ends, index)
        first = self._ends[number - 1] if number else 0
        return self._shards[number], index - first

    def _opened(self, shard: ListedShard) -> tuple[ShardIndex, int]:
        """The index of a shard and a file descriptor of its tar."""
        if shard.file in self._open:
            self._open.move_to_end(shard.file)
            return self._open[shard.file]
        if len(self._open) >= _MAX_OPEN:
            os.close(self._open.popitem(last=False)[1][1])
        self._open[shard.file] = self.manifest.index(shard), self.manifest.store.open_tar(shard)
        return self._open[shard.file]


def find_sample(root: str | Path, key: str) -> SceneSample:
    """The sample with this key, e.g. "train-000012". Raises ShardError listing the available ones."""
    split, _, number = key.rpartition("-")
    manifest = Manifest.load(root)
    counts = {name: sum(shard.samples for shard in manifest.shards(name)) for name in manifest.splits}
    if number.isdecimal() and int(number) < counts.get(split, 0):
        return ShardSplit(root, split)[int(number)]
    there = ", ".join(f"{name}-000000 … {name}-{count - 1:06d}" for name, count in counts.items() if count)
    raise ShardError(f"{root}: no sample '{key}' in this data set: choose from {there}")

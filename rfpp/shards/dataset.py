"""Random access to samples in plain tar files."""

from __future__ import annotations

import bisect
import os
from collections import OrderedDict
from collections.abc import Collection, Sequence
from itertools import accumulate

from torch.utils.data import Dataset

from rfpp.errors import ShardError
from rfpp.raycast.first_hit import CHANNELS
from rfpp.shards.cache import ShardCache
from rfpp.shards.index import SampleEntry
from rfpp.shards.manifest import Manifest
from rfpp.shards.sample import SceneSample, ViewChoice, decode
from rfpp.shards.store import RemoteStore, Root

#: Limit of open shards per process; the least recently used is closed first.
_MAX_OPEN = 32


class ShardSplit(Dataset):
    """The scenes of one split of one or several data sets, by index.

    Reads only the bytes of the requested sample. Picklable: every process opens its own tars.

    Args:
        require_all: Check on construction that all local shards exist with their listed size.

    Attributes:
        shards: its shards, in order.

    Raises:
        ShardError: If there is no data set or no such split; if a shard is missing or truncated; if an index differs
            from the manifest's; or if a sample does not have the recorded sha256. Names the file and the fix.
        UserError: If a server cannot be reached.
    """

    def __init__(
        self, root: Root | Sequence[Root], split: str, cache: ShardCache | None = None, require_all: bool = True
    ) -> None:
        self.manifest = Manifest.load(root, cache)
        self.split = split
        self.shards = self.manifest.shards(split)
        self._ends = list(accumulate(self.sizes))
        self._open: OrderedDict[int, tuple[tuple[SampleEntry, ...], int]] = OrderedDict()
        self._triangles: dict[int, list[int]] = {}
        if require_all:
            for shard in self.shards:
                shard.store.require(shard.listed)

    @property
    def sizes(self) -> list[int]:
        """Number of scenes in each shard."""
        return [shard.listed.samples for shard in self.shards]

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: int) -> SceneSample:
        return self.read(index)

    def read(
        self, index: int, choose: ViewChoice | None = None, channels: Collection[str] = tuple(CHANNELS)
    ) -> SceneSample:
        """Return a scene, or only the requested views and channels (see `rfpp.shards.sample.decode`)."""
        number, position = self._locate(index)
        entries, descriptor = self._opened(number)
        entry = entries[position]
        return decode(entry.key, self.shards[number].members(descriptor, entry), choose, channels)

    def key(self, index: int) -> str:
        """Return the key of a sample, without reading it."""
        number, position = self._locate(index)
        return self._opened(number)[0][position].key

    def shard_of(self, index: int) -> int:
        """Return the number of the shard that holds a sample."""
        return self._locate(index)[0]

    @property
    def is_remote(self) -> bool:
        """True if any shard is behind a URL."""
        return any(isinstance(shard.store, RemoteStore) for shard in self.shards)

    def triangles(self, index: int) -> int:
        """Return the number of triangles of a scene, without opening its shard."""
        number, position = self._locate(index)
        if number not in self._triangles:
            self._triangles[number] = [entry.triangles for entry in self.shards[number].index().samples]
        return self._triangles[number][position]

    def close(self) -> None:
        """Close all files; they are reopened when needed."""
        while self._open:
            os.close(self._open.popitem()[1][1])

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_open": OrderedDict()}

    def __del__(self) -> None:
        if hasattr(self, "_open"):
            self.close()

    def _locate(self, index: int) -> tuple[int, int]:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)} in split '{self.split}'")
        number = bisect.bisect_right(self._ends, index)
        return number, index - (self._ends[number - 1] if number else 0)

    def _opened(self, number: int) -> tuple[tuple[SampleEntry, ...], int]:
        """Return the index entries of a shard and a file descriptor of its tar."""
        if number in self._open:
            self._open.move_to_end(number)
            return self._open[number]
        if len(self._open) >= _MAX_OPEN:
            os.close(self._open.popitem(last=False)[1][1])
        shard = self.shards[number]
        self._open[number] = shard.index().samples, shard.open()
        return self._open[number]


def find_sample(root: Root, key: str) -> SceneSample:
    """Return the sample with this key, e.g. "train-000012". Raises ShardError listing the available keys."""
    split, _, number = key.rpartition("-")
    manifest = Manifest.load(root)
    counts = {name: sum(shard.listed.samples for shard in shards) for name, shards in manifest.splits.items()}
    if number.isdecimal() and int(number) < counts.get(split, 0):
        return ShardSplit(root, split)[int(number)]
    available = ", ".join(f"{name}-000000 … {name}-{count - 1:06d}" for name, count in counts.items() if count)
    raise ShardError(f"{root}: no sample '{key}' in this data set: choose from {available}")

"""Reading: random access to the samples of plain tars, in an order that depends on seed and epoch alone."""

from __future__ import annotations

import bisect
import hashlib
import os
import tarfile
from collections import OrderedDict
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path

import numpy as np
from torch.utils.data import Dataset, Sampler

from rfpp.errors import ShardError
from rfpp.shards.index import ShardIndex
from rfpp.shards.manifest import ListedShard, Manifest
from rfpp.shards.sample import SceneSample, decode
from rfpp.shards.tar import unpack

#: Open shards per process; the one longest unused is closed first.
_MAX_OPEN = 64


class ShardSplit(Dataset):
    """The scenes of one split, by index.

    Reads only the bytes of the sample asked for. Picklable: every process opens the tars it touches itself.

    Args:
        root: folder of the data set.
        split: e.g. "train", "train_newviews", "test".

    Raises:
        ShardError: no data set, no such split, a missing shard or one of the wrong size (at construction), or a
            sample whose bytes do not have the recorded sha256 (when it is read). Each names shard, key and remedy.
    """

    def __init__(self, root: str | Path, split: str) -> None:
        self.manifest = Manifest.load(root)
        self.split = split
        self._root = Path(root)
        self._shards = self.manifest.shards(split)
        self._ends = list(accumulate(shard.samples for shard in self._shards))
        self._open: OrderedDict[str, tuple[ShardIndex, int]] = OrderedDict()
        for shard in self._shards:
            shard.require_intact_file(self._root)

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, index: int) -> SceneSample:
        shard, position = self._locate(index)
        opened, descriptor = self._opened(shard)
        entry = opened.samples[position]
        blocks = os.pread(descriptor, entry.size, entry.offset)
        if hashlib.sha256(blocks).hexdigest() != entry.sha256:
            raise shard.damaged(self._root, entry.key, "does not have the recorded sha256")
        try:
            key, members = unpack(blocks)
        except tarfile.TarError as error:
            raise shard.damaged(self._root, entry.key, f"is not a tar entry ({error})") from error
        if key != entry.key:
            raise shard.damaged(self._root, entry.key, f"is called {key} in the tar")
        return decode(key, members)

    def key(self, index: int) -> str:
        """The key of a sample, without reading it."""
        shard, position = self._locate(index)
        return self._opened(shard)[0].samples[position].key

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
        """Its index and a file descriptor of its tar."""
        if shard.file in self._open:
            self._open.move_to_end(shard.file)
            return self._open[shard.file]
        if len(self._open) >= _MAX_OPEN:
            os.close(self._open.popitem(last=False)[1][1])
        path = shard.require_intact_file(self._root)
        try:
            self._open[shard.file] = self.manifest.index(shard), os.open(path, os.O_RDONLY)
        except OSError as error:
            raise ShardError(f"{path}: cannot be opened ({error.strerror}): check its permissions") from error
        return self._open[shard.file]


class EpochSampler(Sampler[int]):
    """Every index exactly once per epoch, in an order that is a function of (seed, epoch) alone.

    Args:
        length: number of samples.
        seed: of the data order.
    """

    def __init__(self, length: int, seed: int) -> None:
        self._length = length
        self._seed = seed
        self._epoch = 0
        self._start = 0

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[int]:
        order = np.random.default_rng(np.random.SeedSequence([self._seed, self._epoch])).permutation(self._length)
        start, self._start = self._start, 0
        return iter(order[start:].tolist())

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of the next iteration; a different epoch starts at its beginning."""
        if epoch != self._epoch:
            self._epoch, self._start = epoch, 0

    def state_dict(self, position: int) -> dict[str, int]:
        """What resumes the order after `position` samples of this epoch.

        The caller counts what was trained on: a loader with workers has drawn more indices than that.
        """
        return {"seed": self._seed, "epoch": self._epoch, "position": position}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Continue where `state` was taken: the next iteration yields the rest of that epoch."""
        if state["seed"] != self._seed:
            raise ShardError(f"the data order to resume has seed {state['seed']}, this run {self._seed}: set it so")
        self._epoch, self._start = state["epoch"], state["position"]

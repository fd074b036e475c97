"""Concatenate data sets, such as the two halves of the paper's training data."""

from __future__ import annotations

import bisect
import hashlib
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from torch.utils.data import Dataset

from rfpp.errors import ShardError
from rfpp.raycast.first_hit import CHANNELS
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.shards.sample import SceneSample, ViewChoice

Root = str | Path


class JoinedSplit(Dataset):
    """One split of several data sets, concatenated, with the interface of `ShardSplit`."""

    def __init__(self, parts: Sequence[ShardSplit]):
        self._parts = tuple(parts)
        self._ends = list(accumulate(len(part) for part in parts))

    @property
    def sizes(self) -> list[int]:
        return [size for part in self._parts for size in part.sizes]

    def __len__(self) -> int:
        return self._ends[-1]

    def __getitem__(self, index: int) -> SceneSample:
        return self.read(index)

    def read(
        self,
        index: int,
        choose: ViewChoice | None = None,
        channels: Collection[str] = tuple(CHANNELS),
    ) -> SceneSample:
        part, inside = self._locate(index)
        return part.read(inside, choose, channels)

    def key(self, index: int) -> str:
        part, inside = self._locate(index)
        return part.key(inside)

    def triangles(self, index: int) -> int:
        part, inside = self._locate(index)
        return part.triangles(inside)

    def _locate(self, index: int) -> tuple[ShardSplit, int]:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} of {len(self)}")
        number = bisect.bisect_right(self._ends, index)
        return self._parts[number], index - (self._ends[number - 1] if number else 0)


@dataclass(frozen=True)
class JoinedManifest:
    """The combined manifest of several data sets.

    Attributes:
        root, name: of all, with commas and plus signs between.
        hash: of their hashes, in their order.
        counts: sums.
    """

    root: str
    name: str
    hash: str
    counts: dict[str, int]

    @classmethod
    def of(cls, manifests: Sequence[Manifest]) -> JoinedManifest:
        """Raises ShardError where there is no data set, or images are not all of one size."""
        if not manifests:
            raise ShardError("datamodule.root names no data set: give a folder, or several")
        sizes = {str(m.root): m.settings["data"]["resolution"] for m in manifests}
        if len(set(sizes.values())) > 1:
            found = ", ".join(f"{root}: {size}²" for root, size in sizes.items())
            raise ShardError(f"images differ in size ({found}): train on data sets of one resolution")
        return cls(
            root=",".join(sizes),
            name="+".join(m.name for m in manifests),
            hash=hashlib.sha256("".join(m.hash for m in manifests).encode()).hexdigest(),
            counts=dict(sum((Counter(m.counts) for m in manifests), Counter())),
        )


def open_split(
    roots: Root | Sequence[Root], split: str, cache: ShardCache | None = None, require_all: bool = True
) -> ShardSplit | JoinedSplit:
    """A split of one or several data sets; a data set listed twice counts twice. Raises like `ShardSplit`."""
    if isinstance(roots, Root):
        return ShardSplit(roots, split, cache, require_all)
    return JoinedSplit([ShardSplit(root, split, cache, require_all) for root in roots])


def open_manifest(roots: Root | Sequence[Root], cache: ShardCache | None = None) -> Manifest | JoinedManifest:
    """The manifest of one data set or of several. Raises like `Manifest.load` and `JoinedManifest.of`."""
    if isinstance(roots, Root):
        return Manifest.load(roots, cache)
    return JoinedManifest.of([Manifest.load(root, cache) for root in roots])

"""The stored scenes of a training run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from rfpp.errors import ShardError
from rfpp.ranges import Positive
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.manifest import Manifest
from rfpp.shards.store import Root


@dataclass(frozen=True)
class DataSource:
    """The stored scenes to train and validate on.

    Attributes:
        root: folder or URL of a data set, or several to be trained on together; one listed twice counts twice.
        skip_corrupt: omit unreadable training scenes from their batch, with a warning, instead of stopping.
            Validation always stops, because its numbers are compared.
    """

    root: Root | Sequence[Root]
    cache: ShardCache | None
    training_scenes: Positive | None
    validation_scenes: int
    skip_corrupt: bool

    @cached_property
    def manifest(self) -> Manifest:
        """Raises ShardError if there is no data set at `root`, or several do not fit together."""
        return Manifest.load(self.root, self.cache)

    def training(self) -> ShardSplit:
        """Return the `train` split. Raises ShardError if it is empty."""
        split = ShardSplit(self.root, "train", self.cache, require_all=not self.skip_corrupt)
        if len(split) == 0:
            raise ShardError(f"{self.root}: the train split is empty: generate data with data.splits.train above 0")
        return split

    def validation(self) -> ShardSplit:
        """Return the `validation` split."""
        return ShardSplit(self.root, "validation", self.cache)

    def triangles(self, split: ShardSplit, scene: int) -> int:
        """Return the number of triangles of a scene; 0 if its index is unreadable and the scene will be skipped."""
        try:
            return split.triangles(scene)
        except ShardError:
            if not self.skip_corrupt:
                raise
            return 0

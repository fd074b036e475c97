"""Progress of a data set, counted from its folder."""

from __future__ import annotations

from dataclasses import dataclass

from rfpp.shards.checkpointed_shard import UnfinishedShard
from rfpp.shards.manifest import MANIFEST_FILE
from rfpp.shards.recipe import Recipe


@dataclass(frozen=True)
class SplitStatus:
    """Of one split.

    Attributes:
        shards, finished_shards: planned; in place and whole.
        scenes, finished_scenes, waiting_scenes: planned; in finished shards; made, but waiting for their shard.
        failures: key → what went wrong, of scenes that failed when they were last tried.
        missing: numbers in the data set of the shards that are not finished.
    """

    shards: int
    finished_shards: int
    scenes: int
    finished_scenes: int
    waiting_scenes: int
    failures: dict[str, str]
    missing: tuple[int, ...]


@dataclass(frozen=True)
class Status:
    """Of a data set: by split, and whether its manifest is written."""

    splits: dict[str, SplitStatus]
    is_merged: bool

    @property
    def is_complete(self) -> bool:
        return not any(split.missing for split in self.splits.values())

    def slices(self, count: int) -> tuple[int, ...]:
        """The unfinished ones of `count` slices."""
        return tuple(sorted({number % count for split in self.splits.values() for number in split.missing}))


def status(recipe: Recipe) -> Status:
    """Read the status of a data set from its folder.

    Raises:
        ShardError: the folder holds data made with other settings.
    """
    splits, number = {}, 0
    for split, shards in recipe.shards.items():
        finished = [shard.is_finished(recipe.root, recipe.fingerprint) for shard in shards]
        left = [UnfinishedShard.of(recipe, s) for s, whole in zip(shards, finished, strict=True) if not whole]
        splits[split] = SplitStatus(
            shards=len(shards),
            finished_shards=sum(finished),
            scenes=recipe.splits[split],
            finished_scenes=sum(len(s.tasks) for s, whole in zip(shards, finished, strict=True) if whole),
            waiting_scenes=sum(len(shard.shard.tasks) - len(shard.missing()) for shard in left),
            failures={key: error for shard in left for key, error in shard.failures().items()},
            missing=tuple(number + i for i, whole in enumerate(finished) if not whole),
        )
        number += len(shards)
    return Status(splits, (recipe.root / MANIFEST_FILE).exists())

"""Progress of a data set, counted from its folder."""

from __future__ import annotations

from dataclasses import dataclass

from rfpp.shards.checkpointed_shard import UnfinishedShard
from rfpp.shards.manifest import MANIFEST_FILE
from rfpp.shards.recipe import Recipe


@dataclass(frozen=True)
class SplitStatus:
    """Progress of one split.

    Attributes:
        shards, finished_shards: number planned; number finished.
        scenes, finished_scenes, waiting_scenes: number planned; in finished shards; finished, in unfinished shards.
        failures: key → error of scenes whose last attempt failed.
        missing: positions of the unfinished shards in the data set.
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
    """Progress by split, and whether the manifest is written."""

    splits: dict[str, SplitStatus]
    is_merged: bool

    @property
    def is_complete(self) -> bool:
        return not any(split.missing for split in self.splits.values())

    def slices(self, count: int) -> tuple[int, ...]:
        """Return the unfinished ones of `count` slices."""
        return tuple(sorted({number % count for split in self.splits.values() for number in split.missing}))


def status(recipe: Recipe) -> Status:
    """Read the progress of a data set from its folder. Raises ShardError if it holds data of other settings."""
    splits, first = {}, 0
    for split, shards in recipe.shards.items():
        missing = [i for i, shard in enumerate(shards) if not shard.finished(recipe.root, recipe.fingerprint)]
        unfinished = [UnfinishedShard(recipe, shards[number]) for number in missing]
        splits[split] = SplitStatus(
            shards=len(shards),
            finished_shards=len(shards) - len(missing),
            scenes=recipe.splits[split],
            finished_scenes=recipe.splits[split] - sum(len(shards[number].tasks) for number in missing),
            waiting_scenes=sum(len(shard.shard.tasks) - len(shard.missing()) for shard in unfinished),
            failures={key: error for shard in unfinished for key, error in shard.failures().items()},
            missing=tuple(first + number for number in missing),
        )
        first += len(shards)
    return Status(splits, (recipe.root / MANIFEST_FILE).exists())

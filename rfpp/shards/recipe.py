"""The plan of a data set: settings, samples, shards and slices."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rfpp.errors import ShardError, UserError
from rfpp.reference import cycles
from rfpp.shards.index import ShardIndex, load_index, to_json
from rfpp.shards.job import SPLIT_CODES, DatasetSettings, MadeScene, SceneJob, SceneSource, SceneTask
from rfpp.shards.sample import SCHEMA_VERSION
from rfpp.shards.writer import write_json

_SETTINGS_FILE = "settings.json"


@dataclass(frozen=True)
class Slice:
    """Every `count`-th shard, starting at `index`: the part made by one job of an array.

    Raises:
        UserError: the index is not below the count.
    """

    index: int
    count: int

    def __post_init__(self) -> None:
        if not 0 <= self.index < self.count:
            raise UserError(f"slice.index={self.index} of slice.count={self.count}: use 0 to slice.count - 1")


#: One slice with every shard.
WHOLE = Slice(0, 1)


@dataclass(frozen=True)
class PlannedShard:
    """One tar of a data set and the samples it is to hold, in order."""

    file: str
    tasks: tuple[SceneTask, ...]

    def is_finished(self, root: Path, fingerprint: str) -> bool:
        """Whether the shard is complete. Raises ShardError if it was made with other settings."""
        index = self.present(root, fingerprint)
        return index is not None and [entry.key for entry in index.samples] == [task.key for task in self.tasks]

    def present(self, root: Path, fingerprint: str) -> ShardIndex | None:
        """The existing shard, possibly with fewer samples, or None. Raises ShardError if made with other settings."""
        index = load_index(root, self.file)
        if index is not None and index.fingerprint != fingerprint:
            raise other_settings(root, f"{self.file} was made with other settings")
        return index


@dataclass(frozen=True)
class Recipe:
    """A data set as a pure function: every sample follows from its task and the settings.

    Attributes:
        name, root: of the data set.
        splits: split → number of samples.
        views: per sample.
        scenes_per_shard: samples in one tar.
        settings: JSON-able account of everything that the content depends on.
        job: makes a sample; picklable.
    """

    name: str
    root: Path
    splits: Mapping[str, int]
    views: int
    scenes_per_shard: int
    settings: Mapping[str, Any]
    job: Callable[[SceneTask], MadeScene]

    @classmethod
    def of_scenes(
        cls,
        family: SceneSource,
        reference: cycles.CyclesSettings,
        data: DatasetSettings,
        groups: Mapping[str, Any],
        render: Callable[..., np.ndarray] = cycles.render,
    ) -> Recipe:
        """Random scenes of a family.

        Args:
            groups: JSON-able account of family and reference.
            render: Renders images; has the signature of `rfpp.reference.cycles.render`.
        """
        settings = _as_begun(Path(data.root), {"schema_version": SCHEMA_VERSION, "data": data.content(), **groups})
        job = SceneJob(family, reference, data, fingerprint_of(settings), render)
        return cls(data.name, Path(data.root), data.splits, data.views, data.scenes_per_shard, settings, job)

    @cached_property
    def fingerprint(self) -> str:
        """Identifies the settings."""
        return fingerprint_of(self.settings)

    @cached_property
    def shards(self) -> Mapping[str, tuple[PlannedShard, ...]]:
        """Split → its tars, in the order of `SPLIT_CODES`."""
        return {split: tuple(self._shards(split)) for split in SPLIT_CODES if self.splits.get(split)}

    @property
    def all_shards(self) -> tuple[PlannedShard, ...]:
        return tuple(shard for of_split in self.shards.values() for shard in of_split)

    def slice(self, part: Slice) -> tuple[PlannedShard, ...]:
        """The shards of one slice; every shard is in one of them."""
        return self.all_shards[part.index :: part.count]

    def task(self, key: str) -> SceneTask:
        """The task with this key. Raises UserError listing the available ones."""
        split, _, number = key.rpartition("-")
        if number.isdecimal() and int(number) < self.splits.get(split, 0):
            return SceneTask(split, int(number))
        there = ", ".join(f"{s}-000000 … {s}-{n - 1:06d}" for s, n in self.splits.items() if n)
        raise UserError(f"{self.root}: no sample '{key}' is planned: choose from {there}")

    def require_same_settings(self) -> None:
        """Store the settings beside the shards, or compare with those there. Raises ShardError if they differ."""
        path, settings = self.root / _SETTINGS_FILE, json.loads(to_json(self.settings))
        try:
            stored = json.loads(path.read_bytes())
        except FileNotFoundError:
            write_json(path, settings)
            return
        except (OSError, ValueError) as error:
            raise ShardError(f"{path}: unreadable ({error}): delete the folder or choose another data.name") from error
        if changed := sorted(_differences(_without_modules(stored), _without_modules(settings))):
            others = f", and {len(changed) - 1} more" * (len(changed) > 1)
            raise other_settings(self.root, f"{changed[0]} differs{others}")

    def _shards(self, split: str) -> Iterator[PlannedShard]:
        count, size = self.splits[split], self.scenes_per_shard
        for number, first in enumerate(range(0, count, size)):
            tasks = tuple(SceneTask(split, index) for index in range(first, min(first + size, count)))
            yield PlannedShard(f"{split}-{number:05d}.tar", tasks)


def fingerprint_of(settings: Mapping[str, Any]) -> str:
    """A hash of JSON-able settings."""
    return hashlib.sha256(to_json(settings)).hexdigest()


def _as_begun(root: Path, settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """The stored settings if they are equivalent to these, else these, with classes by name.

    Where a class lies is not what it does: a data set outlives that its code is moved.
    """
    named = _without_modules(json.loads(to_json(settings)))
    try:
        stored = json.loads((root / _SETTINGS_FILE).read_bytes())
    except (OSError, ValueError):  # none yet; what is unreadable is said by `require_same_settings`
        return named
    return stored if _without_modules(stored) == named else named


def _without_modules(settings: Any) -> Any:
    if isinstance(settings, list):
        return [_without_modules(item) for item in settings]
    if not isinstance(settings, dict):
        return settings
    return {
        key: value.rpartition(".")[2] if key == "_target_" and isinstance(value, str) else _without_modules(value)
        for key, value in settings.items()
    }


def other_settings(root: Path, why: str) -> ShardError:
    """The error for a folder with other data."""
    return ShardError(
        f"{root}: holds data made with other settings ({why}): choose another data.name, or delete the folder"
    )


def _differences(a: Any, b: Any, where: str = "") -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in a.keys() | b.keys():
            yield from _differences(a.get(key), b.get(key), f"{where}.{key}".lstrip("."))
    elif a != b:
        yield f"{where} ({a} there, {b} now)"

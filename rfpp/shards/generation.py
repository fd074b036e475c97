"""Making a data set: shard by shard, resumable at any moment.

Every sample is a pure function of (data set seed, split, index) and the settings: whoever makes it, on however many
workers, in whatever order, gets the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rfpp.errors import MissingDependencyError, ShardError
from rfpp.reference import cycles
from rfpp.reference.farm import RenderFarm
from rfpp.shards.index import REMEDY, SampleEntry, ShardIndex, load_index
from rfpp.shards.job import SPLIT_CODES, DatasetSettings, SceneJob, SceneSource, SceneTask
from rfpp.shards.manifest import MANIFEST_FILE, Manifest, manifest_json
from rfpp.shards.sample import SCHEMA_VERSION
from rfpp.shards.writer import ShardWriter, write_json

_SETTINGS_FILE = "settings.json"
_FAILURES_FILE = "failures.json"


def generate(
    family: SceneSource,
    reference: cycles.CyclesSettings,
    data: DatasetSettings,
    settings: Mapping[str, Any],
    progress: Callable[[int, int], None],
    render: Callable[..., np.ndarray] = cycles.render,
) -> Manifest:
    """Make whatever is missing of a data set and write its manifest.

    Finished shards are left alone; of a shard that lacks some samples the others are copied. A failing scene is
    tried twice, then listed in failures.json with its traceback, and the rest goes on.

    Args:
        family, reference, data: see `SceneJob`.
        settings: JSON-able account of family and reference, stored and compared with what is on disk.
        progress: called with (scenes finished, scenes in all), first with what is there already.
        render: with the signature of `rfpp.reference.cycles.render`.

    Raises:
        ShardError: the folder holds data made with other settings, or scenes failed.
        MissingDependencyError: Blender or Embree is not installed.
        UserError: the disk is full.
    """
    root = Path(data.root)
    settings = json.loads(json.dumps({"schema_version": SCHEMA_VERSION, "data": data.content(), **settings}))
    fingerprint = _require_same_settings(root, settings)
    job = SceneJob(family, reference, data, fingerprint, render)
    plan = {split: _plan(root, split, data, fingerprint) for split in SPLIT_CODES if data.splits.get(split)}
    tally = _Tally(progress, [shard for shards in plan.values() for shard in shards])
    failures: dict[SceneTask, Exception] = {}
    with RenderFarm(data.workers) as farm:
        for split, shards in plan.items():
            if split == "train_newviews" and failures:
                continue  # the scenes to show may be among the failed
            attempts = _scene_attempts(plan["train"]) if split == "train_newviews" else {}
            unfinished = [shard for shard in shards if not shard.is_finished]
            _make(job, farm, root, unfinished, attempts, tally, failures)
    _record_failures(root, data, failures)
    splits = {split: [shard.present for shard in shards] for split, shards in plan.items()}
    content = manifest_json(data.name, settings, data.views, splits)
    if not _same_json(root / MANIFEST_FILE, content):
        write_json(root / MANIFEST_FILE, content)
    return Manifest.load(root)


@dataclass
class _PlannedShard:
    """One tar of the data set: what it is to hold, and what of it is there."""

    file: str
    tasks: list[SceneTask]
    present: ShardIndex | None

    @property
    def entries(self) -> dict[str, SampleEntry]:
        return {entry.key: entry for entry in self.present.samples} if self.present else {}

    @property
    def is_finished(self) -> bool:
        return list(self.entries) == [task.key for task in self.tasks]

    @property
    def num_done(self) -> int:
        return sum(task.key in self.entries for task in self.tasks)


class _Tally:
    """Counts scenes over all splits for the progress bar."""

    def __init__(self, progress: Callable[[int, int], None], shards: list[_PlannedShard]) -> None:
        self._progress = progress
        self._done = sum(shard.num_done for shard in shards)
        self._total = sum(len(shard.tasks) for shard in shards)
        progress(self._done, self._total)

    def one_more(self) -> None:
        self._done += 1
        self._progress(self._done, self._total)


def _plan(root: Path, split: str, data: DatasetSettings, fingerprint: str) -> list[_PlannedShard]:
    count, size = data.splits[split], data.scenes_per_shard
    shards = []
    for number, first in enumerate(range(0, count, size)):
        file = f"{split}-{number:05d}.tar"
        present = load_index(root, file)
        if present is not None and present.fingerprint != fingerprint:
            raise _other_settings(root, f"{file} was made with other settings")
        tasks = [SceneTask(split, index) for index in range(first, min(first + size, count))]
        shards.append(_PlannedShard(file, tasks, present))
    return shards


def _make(
    job: SceneJob,
    farm: RenderFarm,
    root: Path,
    shards: list[_PlannedShard],
    scene_attempts: Mapping[str, int],
    tally: _Tally,
    failures: dict[SceneTask, Exception],
) -> None:
    """Make the unfinished shards of one split, in order; no worker waits for a shard to end."""
    made = farm.map(job, _missing_tasks(shards, scene_attempts))
    try:
        for shard in shards:
            writer = ShardWriter(root, shard.file, job.fingerprint)
            try:
                for task in shard.tasks:
                    if task.key in shard.entries:
                        _copy(root, shard, task.key, writer)
                        continue
                    result = next(made)[1]
                    if isinstance(result, MissingDependencyError):
                        raise result
                    if isinstance(result, Exception):
                        failures[task] = result
                    else:
                        writer.add(task.key, **vars(result))
                        tally.one_more()
                shard.present = writer.commit()
            except KeyboardInterrupt:
                if writer.is_open:  # the next run takes over what is there
                    for key in sorted(shard.entries.keys() - writer.keys):
                        _copy(root, shard, key, writer)
                    writer.commit()
                raise
            finally:
                writer.discard()
    finally:
        made.close()


def _missing_tasks(shards: Iterable[_PlannedShard], scene_attempts: Mapping[str, int]) -> Iterator[SceneTask]:
    for shard in shards:
        for task in shard.tasks:
            if task.key not in shard.entries:
                yield replace(task, scene_attempt=scene_attempts.get(f"{task.scene_split}-{task.index:06d}"))


def _scene_attempts(train: list[_PlannedShard]) -> dict[str, int]:
    """Which draw became the training scene, so that new views show that very scene."""
    return {key: entry.scene_redraws for shard in train for key, entry in shard.entries.items()}


def _copy(root: Path, shard: _PlannedShard, key: str, writer: ShardWriter) -> None:
    """Take over a finished sample from the incomplete shard that is to be replaced."""
    entry = shard.entries[key]
    with (root / shard.file).open("rb") as file:
        blocks = os.pread(file.fileno(), entry.size, entry.offset)
    if hashlib.sha256(blocks).hexdigest() != entry.sha256:
        raise shard.present.damaged(root, key, "does not have the recorded sha256")
    kept = ("triangles", "objects", "scene_redraws", "empty_views", "unlit_views")
    writer.add(key, blocks, **{name: getattr(entry, name) for name in kept})


def _require_same_settings(root: Path, settings: dict[str, Any]) -> str:
    """Store the settings beside the shards, or compare with those there; returns their fingerprint."""
    path = root / _SETTINGS_FILE
    try:
        stored = json.loads(path.read_bytes())
    except FileNotFoundError:
        write_json(path, settings)
        stored = settings
    except (OSError, ValueError) as error:
        raise ShardError(f"{path}: unreadable ({error}): delete the folder or choose another data.name") from error
    if stored != settings:
        changed = sorted(_differences(stored, settings))
        raise _other_settings(root, f"{changed[0]} differs" + (f", and {len(changed) - 1} more" * (len(changed) > 1)))
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def _differences(a: Any, b: Any, where: str = "") -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in a.keys() | b.keys():
            yield from _differences(a.get(key), b.get(key), f"{where}.{key}".lstrip("."))
    elif a != b:
        yield f"{where} ({a} there, {b} now)"


def _other_settings(root: Path, why: str) -> ShardError:
    return ShardError(
        f"{root}: holds data made with other settings ({why}): choose another data.name, or delete the folder"
    )


def _same_json(path: Path, content: Any) -> bool:
    try:
        return json.loads(path.read_bytes()) == content
    except (OSError, ValueError):
        return False


def _record_failures(root: Path, data: DatasetSettings, failures: Mapping[SceneTask, Exception]) -> None:
    """Write failures.json and raise ShardError if any scene failed."""
    path = root / _FAILURES_FILE
    if not failures:
        path.unlink(missing_ok=True)
        return
    rows = [
        {
            "key": task.key,
            "seed": data.seed,
            "split": task.split,
            "index": task.index,
            "error": f"{type(error).__name__}: {error}",
            "traceback": "\n".join(getattr(error, "__notes__", [])),
        }
        for task, error in failures.items()
    ]
    write_json(path, rows)
    first = rows[0]
    raise ShardError(
        f"{len(rows)} of {sum(data.splits.values())} scenes failed, first {first['key']} (data.seed {data.seed}: "
        f"{first['error']}); the others are finished; see {path}, mend the cause and {REMEDY}"
    )

"""A shard in progress: one file per finished sample, so that interruptions lose nothing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from rfpp.errors import ShardError
from rfpp.files import write_atomically
from rfpp.shards.index import SampleEntry, ShardIndex, to_json
from rfpp.shards.job import MadeScene, SceneTask
from rfpp.shards.recipe import PlannedShard, Recipe
from rfpp.shards.writer import ShardWriter, write_json

#: Of a data set's folder.
FOLDER = "unfinished"


@dataclass(frozen=True)
class SampleFolder:
    """Folder of the finished samples of an incomplete shard; picklable.

    Each is written by the worker that made it, whole or not at all: whatever is killed, and whenever, only scenes
    in the making are lost.
    """

    path: Path
    fingerprint: str

    def write(self, key: str, made: MadeScene) -> None:
        """Store a sample. Raises UserError (full disk)."""
        counts = {name: value for name, value in asdict(made).items() if name != "blocks"}
        head = {"counts": counts, "sha256": hashlib.sha256(made.blocks).hexdigest(), "settings": self.fingerprint}
        write_atomically(self._file(key), to_json(head) + made.blocks)
        self._failure_file(key).unlink(missing_ok=True)

    def read(self, key: str) -> MadeScene | None:
        """A stored sample; None if it is missing or was truncated by a machine crash.

        Raises:
            ShardError: it was made with other settings.
        """
        try:
            head, _, blocks = self._file(key).read_bytes().partition(b"\n")
            head = json.loads(head)
        except (OSError, ValueError):
            return None
        if head["settings"] != self.fingerprint:
            raise ShardError(f"{self._file(key)}: was made with other settings: delete it, or choose another data.name")
        if hashlib.sha256(blocks).hexdigest() != head["sha256"]:
            return None
        return MadeScene(blocks, **head["counts"])

    def remove(self, key: str) -> None:
        """Delete a sample, and the folder with the last one."""
        self._file(key).unlink(missing_ok=True)
        for folder in (self.path, self.path.parent):
            with suppress(OSError):  # not empty
                folder.rmdir()

    def write_failure(self, key: str, error: Exception) -> Path:
        """Record the failure of a scene; returns the file."""
        traceback = "\n".join(getattr(error, "__notes__", []))
        path = self._failure_file(key)
        write_json(path, {"key": key, "error": f"{type(error).__name__}: {error}", "traceback": traceback})
        return path

    def read_failure(self, key: str) -> str | None:
        """The error of the scene's last attempt, if it failed."""
        try:
            return json.loads(self._failure_file(key).read_bytes())["error"]
        except FileNotFoundError:
            return None

    def _file(self, key: str) -> Path:
        return self.path / f"{key}.sample"

    def _failure_file(self, key: str) -> Path:
        return self.path / f"{key}.failed.json"


@dataclass(frozen=True)
class UnfinishedShard:
    """A shard whose samples are missing or not yet assembled."""

    root: Path
    shard: PlannedShard
    fingerprint: str

    @classmethod
    def of(cls, recipe: Recipe, shard: PlannedShard) -> UnfinishedShard:
        return cls(recipe.root, shard, recipe.fingerprint)

    @property
    def folder(self) -> SampleFolder:
        return SampleFolder(self.root / FOLDER / Path(self.shard.file).stem, self.fingerprint)

    def missing(self) -> list[SceneTask]:
        """The samples that are neither waiting nor in the shard in place, which may hold fewer than planned.

        Raises:
            ShardError: something was made with other settings.
        """
        entries = self._entries()
        return [t for t in self.shard.tasks if t.key not in entries and self.folder.read(t.key) is None]

    def failures(self) -> dict[str, str]:
        """Key → error of the scenes whose last attempt failed."""
        errors = {task.key: self.folder.read_failure(task.key) for task in self.shard.tasks}
        return {key: error for key, error in errors.items() if error is not None}

    def assemble(self) -> ShardIndex:
        """Write the shard from its samples, move it into place, and clear the folder.

        Raises:
            UserError: the disk is full; nothing is lost.
        """
        entries = self._entries()
        writer = ShardWriter(self.root, self.shard.file, self.fingerprint)
        try:
            for task in self.shard.tasks:
                made = self.folder.read(task.key) or self._copy(entries[task.key])
                writer.add(task.key, **vars(made))
            index = writer.commit()
        finally:
            writer.discard()
        for task in self.shard.tasks:
            self.folder.remove(task.key)
        return index

    def _entries(self) -> dict[str, SampleEntry]:
        present = self.shard.present(self.root, self.fingerprint)
        return {entry.key: entry for entry in present.samples} if present else {}

    def _copy(self, entry: SampleEntry) -> MadeScene:
        """Copy a sample from the smaller shard that is being replaced."""
        present = self.shard.present(self.root, self.fingerprint)
        with (self.root / self.shard.file).open("rb") as file:
            blocks = present.blocks(self.root, file.fileno(), entry)
        counts = entry._asdict()
        return MadeScene(blocks, **{name: counts[name] for name in MadeScene.__annotations__ if name != "blocks"})


@dataclass(frozen=True)
class KeptJob:
    """Makes a sample and stores it in its shard's sample folder; picklable."""

    job: Callable[[SceneTask], MadeScene]

    def __call__(self, task_and_folder: tuple[SceneTask, SampleFolder]) -> None:
        task, folder = task_and_folder
        folder.write(task.key, self.job(task))

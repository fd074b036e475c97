"""A shard in progress: one file per finished sample, so that interruptions lose nothing."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from rfpp.errors import ShardError
from rfpp.files import write_atomically
from rfpp.shards.index import to_json
from rfpp.shards.job import SampleBlocks, SceneTask
from rfpp.shards.recipe import PlannedShard, Recipe
from rfpp.shards.writer import write_json, write_shard

#: Folder of unfinished shards in a data set's folder.
FOLDER = "unfinished"


@dataclass(frozen=True)
class SampleFolder:
    """Finished samples of an incomplete shard; picklable.

    The worker that makes a sample writes it atomically, so that a killed run loses only the scenes in progress.
    """

    path: Path
    fingerprint: str

    def write(self, key: str, made: SampleBlocks) -> None:
        """Store a sample. Raises UserError (full disk)."""
        counts = {name: value for name, value in asdict(made).items() if name != "blocks"}
        head = {"counts": counts, "sha256": hashlib.sha256(made.blocks).hexdigest(), "settings": self.fingerprint}
        write_atomically(self._file(key), to_json(head) + made.blocks)
        self._failure_file(key).unlink(missing_ok=True)

    def read(self, key: str) -> SampleBlocks | None:
        """Return a stored sample, or None if it is missing or was truncated by a crash of the machine.

        Raises:
            ShardError: If it has other settings.
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
        return SampleBlocks(blocks, **head["counts"])

    def clear(self) -> None:
        """Delete the folder with all samples, and with what killed workers did not finish."""
        shutil.rmtree(self.path, ignore_errors=True)
        with suppress(OSError):  # holds other shards
            self.path.parent.rmdir()

    def write_failure(self, key: str, error: Exception) -> None:
        """Record the failure of a scene."""
        traceback = "\n".join(getattr(error, "__notes__", []))
        record = {"key": key, "error": f"{type(error).__name__}: {error}", "traceback": traceback}
        write_json(self._failure_file(key), record)

    def read_failure(self, key: str) -> str | None:
        """Return the error of the scene's last attempt, if it failed."""
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
    """A shard with missing or unassembled samples."""

    recipe: Recipe
    shard: PlannedShard

    @property
    def folder(self) -> SampleFolder:
        return SampleFolder(self.recipe.root / FOLDER / Path(self.shard.file).stem, self.recipe.fingerprint)

    def missing(self) -> list[SceneTask]:
        """Return the samples that are not in the folder. Raises ShardError if a sample has other settings."""
        return [task for task in self.shard.tasks if self.folder.read(task.key) is None]

    def failures(self) -> dict[str, str]:
        """Return key → error of the scenes whose last attempt failed."""
        errors = {task.key: self.folder.read_failure(task.key) for task in self.shard.tasks}
        return {key: error for key, error in errors.items() if error is not None}

    def assemble(self) -> None:
        """Write the shard from its samples, move it into place, and clear the folder.

        Raises:
            UserError: If the disk is full; nothing is lost.
        """
        samples = ((task.key, self.folder.read(task.key)) for task in self.shard.tasks)
        write_shard(self.recipe.root, self.shard.file, self.recipe.fingerprint, samples)
        self.folder.clear()


@dataclass(frozen=True)
class CheckpointedJob:
    """Task that makes a sample and stores it in its shard's sample folder; picklable."""

    job: Callable[[SceneTask], SampleBlocks]

    def __call__(self, task_and_folder: tuple[SceneTask, SampleFolder]) -> None:
        task, folder = task_and_folder
        folder.write(task.key, self.job(task))

"""Checkpoint files: written atomically in the background, validated before resuming."""

from __future__ import annotations

import io
import os
import warnings
import zipfile
import zlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from time import sleep
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

from rfpp.checkpoint.loading import CHECKPOINT_KEY, read_checkpoint
from rfpp.errors import CheckpointError, UserError
from rfpp.files import write_atomically

#: `checkpoint=auto` resumes from the newest intact checkpoint of the run's folder, if there is one.
AUTO = "auto"
#: Seconds before each further attempt to write a checkpoint.
REPEATED_AFTER = (2, 20)


class BackgroundCheckpointIO(TorchCheckpointIO):
    """Writes checkpoints in a thread, atomically; training waits only while tensors are copied to host memory.

    A failed write is repeated. If it fails again, training continues with a warning and the files written before.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "checkpoint")
        self._writing: Future[None] | None = None

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        """Copy a checkpoint and start writing it, after the one before.

        Args:
            storage_options: Called without arguments when the file is in place, or None.
        """
        self._failure()
        content = io.BytesIO()
        torch.save(checkpoint, content)
        self._writing = self._thread.submit(_write, Path(path), content, storage_options)

    def wait(self) -> None:
        """Wait until the last checkpoint is on disk. Raises UserError if it could not be written."""
        if error := self._failure():
            raise error

    def remove_checkpoint(self, path: str | Path) -> None:
        """Remove a checkpoint, unless the one that replaces it could not be written."""
        if self._failure() is None:
            super().remove_checkpoint(path)

    def teardown(self) -> None:
        self._failure()

    def _failure(self) -> BaseException | None:
        return None if self._writing is None else self._writing.exception()


def _write(path: Path, content: io.BytesIO, when_written: Callable[[], None] | None) -> None:
    for pause in (*REPEATED_AFTER, None):
        try:
            write_atomically(path, content.getbuffer())
            break
        except UserError as error:
            retry = f"trying again in {pause} s" if pause else "the next checkpoint is the next attempt"
            warnings.warn(f"{error}; training continues, {retry}", stacklevel=1)
            if pause is None:
                raise
            sleep(pause)
    if when_written:
        when_written()


def step_file(folder: Path, step: int) -> Path:
    """Return the path of the checkpoint after `step` steps."""
    return folder / f"step-{step:08d}.ckpt"


def step_files(folder: Path) -> list[Path]:
    """Return all resumable checkpoints, oldest first."""
    return sorted(folder.glob("step-*.ckpt"))


def step_of(path: Path) -> int:
    """Return the steps before a resumable checkpoint, by its name."""
    return int(path.stem.removeprefix("step-"))


def keep_newest(folder: Path, count: int, milestones: int) -> None:
    """Delete resumable checkpoints, and partial files of killed processes.

    Args:
        count: The newest are kept.
        milestones: Those after a multiple of this many steps are kept.
    """
    older = [path for path in step_files(folder)[:-count] if step_of(path) % milestones]
    for path in [*older, *folder.glob(".*.ckpt.*")]:
        path.unlink(missing_ok=True)


def point_at(target: Path, link: Path) -> None:
    """Make `link` a link to a file or folder beside it, atomically replacing an existing link."""
    temporary = link.with_name(f".{link.name}-{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target.name)
    os.replace(temporary, link)


def checkpoint_to_resume(choice: str | None, folder: Path, model: dict[str, Any]) -> Path | None:
    """Return the checkpoint to resume from; None starts a new run.

    With AUTO, damaged checkpoints are skipped with a warning.

    Args:
        choice: Path, None or AUTO.

    Raises:
        CheckpointError: If the chosen checkpoint, or each one in the folder, is missing or damaged, or if it holds
            another network.
    """
    if choice is None:
        return None
    candidates = step_files(folder)[::-1] if choice == AUTO else [Path(choice)]
    for path in candidates:
        defect = find_defect(path)
        if defect is None:
            _require_same_network(path, model)
            return path
        if choice != AUTO:
            raise CheckpointError(f"{path}: {defect}: choose another checkpoint")
        warnings.warn(f"{path}: {defect}; trying the checkpoint before", stacklevel=2)
    if candidates:
        raise CheckpointError(
            f"{folder}: all {len(candidates)} checkpoints are damaged: start a new run with checkpoint=null or another "
            "run_dir"
        )
    return None


def find_defect(path: Path) -> str | None:
    """Return the defect of a checkpoint file, found by its checksums; None if it is intact."""
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
    except FileNotFoundError:
        return "no such checkpoint"
    # NotImplementedError: the header names an unknown compression
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError) as error:
        return f"truncated or not a checkpoint ({error})"
    return f"damaged (checksum of {damaged})" if damaged else None


def _require_same_network(path: Path, model: dict[str, Any]) -> None:
    about = read_checkpoint(path, mmap=True)[CHECKPOINT_KEY]
    if not isinstance(about, dict) or about.get("model") != model:
        raise CheckpointError(f"{path}: holds another network than `model`: use its settings or another run_dir")

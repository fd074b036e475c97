"""Checkpoint files: written atomically, validated before resuming."""

from __future__ import annotations

import io
import os
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

from rfpp.checkpoint.loading import CHECKPOINT_KEY, read_checkpoint
from rfpp.errors import CheckpointError
from rfpp.files import write_atomically

#: `checkpoint=auto` resumes from the newest intact checkpoint of the run's folder, if there is one.
AUTO = "auto"


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes a temporary file in the same folder and renames it; Lightning uses the system's temporary folder.

    Raises:
        UserError: If the file cannot be written, e.g. because the disk is full. An existing file stays unchanged.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        content = io.BytesIO()
        torch.save(checkpoint, content)
        write_atomically(Path(path), content.getvalue())


def step_file(folder: Path, step: int) -> Path:
    """Return the path of the checkpoint after `step` steps."""
    return folder / f"step-{step:08d}.ckpt"


def step_files(folder: Path) -> list[Path]:
    """Return all resumable checkpoints, oldest first."""
    return sorted(folder.glob("step-*.ckpt"))


def keep_newest(folder: Path, count: int) -> None:
    """Delete all but the newest resumable checkpoints, and partial files of killed processes."""
    for path in [*step_files(folder)[:-count], *folder.glob(".*.ckpt.*")]:
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

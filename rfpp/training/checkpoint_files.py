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
from rfpp.checkpoint.renamed import with_current_names
from rfpp.errors import CheckpointError
from rfpp.files import write_atomically

#: `checkpoint=auto` goes on from the newest sound checkpoint of the run's folder, if there is one.
AUTO = "auto"


class AtomicCheckpointIO(TorchCheckpointIO):
    """Writes a temporary file in the same folder and renames it; Lightning uses the system's temporary folder.

    Raises:
        UserError: the disk is full, and the like; the file that was there before is left as it was.
    """

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any = None) -> None:
        content = io.BytesIO()
        torch.save(checkpoint, content)
        write_atomically(Path(path), content.getvalue())


def step_file(folder: Path, step: int) -> Path:
    """File of the checkpoint after `step` steps."""
    return folder / f"step-{step:08d}.ckpt"


def step_files(folder: Path) -> list[Path]:
    """Resumable checkpoints, oldest first."""
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
    """The checkpoint a run starts from; None starts it anew.

    A damaged one is passed over for the one before, with a warning that names it.

    Args:
        choice: a path, None or AUTO.
        folder: of the run's checkpoints.
        model: config of the network to be trained.

    Raises:
        CheckpointError: the chosen one is missing or damaged, or all of the folder's are; it is of another network.
    """
    if choice is None:
        return None
    candidates = step_files(folder)[::-1] if choice == AUTO else [Path(choice)]
    for path in candidates:
        defect = find_defect(path)
        if defect is None:
            _check_same_network(path, model)
            return path
        if choice != AUTO:
            raise CheckpointError(f"{path}: {defect}: choose another checkpoint")
        warnings.warn(f"{path}: {defect}; going on from the one before", stacklevel=2)
    if candidates:
        raise CheckpointError(
            f"{folder}: none of the {len(candidates)} checkpoints can be read: "
            "start anew with checkpoint=null, or in another run_dir"
        )
    return None


def find_defect(path: Path) -> str | None:
    """The defect of a checkpoint file, by its checksums; None if it is intact."""
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
    except FileNotFoundError:
        return "no such checkpoint"
    # the last of these is zipfile's word for a header that names a compression it does not know
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError) as error:
        return f"truncated or not a checkpoint ({error})"
    return f"damaged ({damaged} has another checksum than when it was written)" if damaged else None


def _check_same_network(path: Path, model: dict[str, Any]) -> None:
    about = read_checkpoint(path, mmap=True)[CHECKPOINT_KEY]
    if not isinstance(about, dict) or with_current_names(about.get("model")) != model:
        raise CheckpointError(
            f"{path}: of another network than this command's `model`: give its settings, or start in another run_dir"
        )

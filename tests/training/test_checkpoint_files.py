"""Checkpoint files are written completely or not at all, and the newest intact one is resumed."""

import errno
import os
from dataclasses import replace

import pytest
import torch
from networks import checkpoint_info

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.errors import CheckpointError, UserError
from rfpp.training.checkpoint_files import (
    AUTO,
    AtomicCheckpointIO,
    checkpoint_to_resume,
    find_defect,
    keep_newest,
    point_at,
    step_file,
    step_files,
)

INFO = checkpoint_info(model={"width": 3})


@pytest.fixture
def folder(tmp_path):
    """Three checkpoints."""
    for step in (1, 20, 300):
        content = {"state_dict": {"w": torch.arange(5000.0) + step}, CHECKPOINT_KEY: INFO.to_dict()}
        AtomicCheckpointIO().save_checkpoint(content, step_file(tmp_path, step))
    return tmp_path


def flip(path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def damage(path, how: str) -> None:
    size = path.stat().st_size
    if how == "flipped bit":
        flip(path, size // 2)
    else:
        path.write_bytes(path.read_bytes()[: {"empty": 0, "half": size // 2, "but the last byte": size - 1}[how]])


def test_the_newest_is_resumed(folder):
    assert checkpoint_to_resume(AUTO, folder, INFO.model) == step_file(folder, 300)
    assert checkpoint_to_resume(AUTO, folder / "new", INFO.model) is None
    assert checkpoint_to_resume(None, folder, INFO.model) is None
    assert checkpoint_to_resume(str(step_file(folder, 20)), folder, INFO.model) == step_file(folder, 20)


@pytest.mark.parametrize("how", ["flipped bit", "empty", "half", "but the last byte"])
def test_a_damaged_checkpoint_is_skipped_with_a_warning(folder, how):
    damage(step_file(folder, 300), how)
    with pytest.warns(UserWarning, match=r"step-00000300\.ckpt: .*; trying the checkpoint before"):
        assert checkpoint_to_resume(AUTO, folder, INFO.model) == step_file(folder, 20)
    with pytest.raises(CheckpointError, match=r"step-00000300\.ckpt: .*: choose another checkpoint"):
        checkpoint_to_resume(str(step_file(folder, 300)), folder, INFO.model)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_no_new_run_starts_if_all_are_damaged(folder):
    for path in step_files(folder):
        damage(path, "half")
    with pytest.raises(CheckpointError, match="all 3 checkpoints are damaged: start a new run with checkpoint=null"):
        checkpoint_to_resume(AUTO, folder, INFO.model)


def test_a_checkpoint_of_another_network_is_refused(folder):
    other = replace(INFO, model={"width": 4})
    with pytest.raises(CheckpointError, match="holds another network than `model`"):
        checkpoint_to_resume(AUTO, folder, other.model)


def test_the_newest_are_kept_and_partial_files_are_deleted(folder):
    (folder / ".step-00000301.ckpt.x7").write_bytes(b"half")
    keep_newest(folder, 2)
    assert {path.name for path in folder.iterdir()} == {"step-00000020.ckpt", "step-00000300.ckpt"}


def test_a_full_disk_leaves_the_old_file_unchanged(folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    path = step_file(folder, 300)
    before = path.read_bytes()
    with pytest.raises(UserError, match=r"step-00000300\.ckpt: cannot be written \(No space left on device\)"):
        AtomicCheckpointIO().save_checkpoint({"state_dict": {}}, path)
    assert path.read_bytes() == before
    assert find_defect(path) is None
    assert len(list(folder.iterdir())) == 3


def test_a_link_is_replaced(folder):
    for step in (20, 300):
        point_at(step_file(folder, step), folder / "last.ckpt")
    assert (folder / "last.ckpt").resolve() == step_file(folder, 300)
    assert len(list(folder.iterdir())) == 4

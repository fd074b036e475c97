"""Checkpoint files are written completely or not at all, and the newest intact one is resumed."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from networks import checkpoint_info

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.errors import CheckpointError, UserError
from rfpp.training import checkpoint_files
from rfpp.training.checkpoint_files import (
    AUTO,
    BackgroundCheckpointIO,
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
    checkpoint_io = BackgroundCheckpointIO()
    for step in (1, 20, 300):
        content = {"state_dict": {"w": torch.arange(5000.0) + step}, CHECKPOINT_KEY: INFO.to_dict()}
        checkpoint_io.save_checkpoint(content, step_file(tmp_path, step))
    checkpoint_io.wait()
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


def test_the_newest_and_milestones_are_kept_and_partial_files_are_deleted(folder):
    (folder / ".step-00000301.ckpt.x7").write_bytes(b"half")
    for count, milestones, expected in ((2, 7, [20, 300]), (1, 20, [20, 300]), (1, 7, [300])):
        keep_newest(folder, count, milestones)
        assert sorted(folder.iterdir()) == [step_file(folder, step) for step in expected]


def save_and(checkpoint_io, then, path, when_written=None):
    """Save, whose thread may warn at once, and do something that waits for it."""
    checkpoint_io.save_checkpoint({"state_dict": {}}, path, when_written)
    then()


def test_a_full_disk_leaves_the_old_file_unchanged(folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    monkeypatch.setattr(checkpoint_files, "REPEATED_AFTER", (0.2,))
    path, checkpoint_io = step_file(folder, 300), BackgroundCheckpointIO()
    before = path.read_bytes()
    with pytest.warns(UserWarning, match=r"step-00000300\.ckpt: cannot be written \(No space.*training continues"):
        save_and(checkpoint_io, lambda: checkpoint_io.remove_checkpoint(path), path)
    with pytest.raises(UserError, match=r"step-00000300\.ckpt: cannot be written \(No space left on device\)"):
        checkpoint_io.wait()
    assert path.read_bytes() == before
    assert find_defect(path) is None
    assert len(list(folder.iterdir())) == 3


def test_a_failed_write_is_repeated(folder, monkeypatch):
    attempts = []

    def full_once(source, target):
        attempts.append(target)
        if len(attempts) == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        Path(source).rename(target)

    monkeypatch.setattr(os, "replace", full_once)
    monkeypatch.setattr(checkpoint_files, "REPEATED_AFTER", (0.2,))
    checkpoint_io, written = BackgroundCheckpointIO(), []
    with pytest.warns(UserWarning, match="trying again"):
        save_and(checkpoint_io, checkpoint_io.wait, step_file(folder, 400), lambda: written.append(1))
    assert find_defect(step_file(folder, 400)) is None
    assert (len(attempts), written) == (2, [1])


def test_a_checkpoint_holds_the_values_at_the_time_of_saving(folder):
    weights, checkpoint_io = torch.zeros(1_000_000), BackgroundCheckpointIO()
    checkpoint_io.save_checkpoint({"state_dict": {"w": weights}}, step_file(folder, 500))
    weights.fill_(1)  # the next step
    checkpoint_io.wait()
    assert not torch.load(step_file(folder, 500))["state_dict"]["w"].any()


def test_a_link_is_replaced(folder):
    for step in (20, 300):
        point_at(step_file(folder, step), folder / "last.ckpt")
    assert (folder / "last.ckpt").resolve() == step_file(folder, 300)
    assert len(list(folder.iterdir())) == 4

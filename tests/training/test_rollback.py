"""Going back to an earlier checkpoint: which one is taken, and that a requeued job does not go back again."""

import torch
from networks import checkpoint_info

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.training.checkpoint_files import step_file
from rfpp.training.rollback import continues_job, omit_steps, omitted_steps
from rfpp.training.tracking.journal import JOURNAL, Journal


def test_the_newest_intact_checkpoint_before_the_steps_is_taken(tmp_path):
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    for step in (8, 9, 10):
        content = {CHECKPOINT_KEY: checkpoint_info().to_dict(), "global_step": step}
        torch.save(content, step_file(folder, step))
    assert omit_steps(tmp_path, range(8, 9)) is None
    assert omitted_steps(tmp_path) == []
    damaged = step_file(folder, 9)
    damaged.write_bytes(damaged.read_bytes()[:-100])
    assert omit_steps(tmp_path, range(10, 12)) == step_file(folder, 8)
    assert omitted_steps(tmp_path) == [range(10, 12)]
    assert [path.name for path in sorted(folder.glob("step-*"))] == ["step-00000008.ckpt"]


def test_a_requeued_job_does_not_go_back_again(tmp_path, monkeypatch):
    Journal(tmp_path / JOURNAL).append("tags", values={"slurm_job_id": "7"})
    for restarts, job, expected in (("0", "7", False), ("1", "7", True), ("1", "8", False)):
        monkeypatch.setenv("SLURM_RESTART_COUNT", restarts)
        monkeypatch.setenv("SLURM_JOB_ID", job)
        assert continues_job(tmp_path) is expected

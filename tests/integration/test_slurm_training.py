"""Training under Slurm: two nodes, told to stop, requeued, and in the end the weights of a run that never stopped."""

import sys
from pathlib import Path

import torch
from marks import requires_slurm
from small_data import make
from training_runs import SETTINGS, differing, train, wait_for_step

REPOSITORY = Path(__file__).resolve().parents[2]
RUN = ("steps=12", "trainer.val_check_interval=5", "+callbacks.skewed._target_=skewed.Skewed")


@requires_slurm
def test_a_preempted_job_of_two_nodes_is_requeued_and_goes_on(slurm, tmp_path):
    data = Path(make(tmp_path / "data" / "small", splits={"train": 7, "validation": 2}).root)
    environment = {"PYTHON": sys.executable, "PYTHONPATH": REPOSITORY / "tests", "MASTER_ADDR": "127.0.0.1"}
    job = slurm.submit(
        "--nodes=2", "--ntasks-per-node=1", "--cpus-per-task=1", "--gpus-per-node=0", f"--output={tmp_path}/log",
        "--export=ALL,OMP_NUM_THREADS=1," + ",".join(f"{key}={value}" for key, value in environment.items()),
        "launch/slurm/train.sbatch", *SETTINGS, *RUN, "trainer.strategy=ddp", f"data.root={data}",
        f"run_dir={tmp_path}/${{oc.env:RFPP_RUN}}", f"logger.folder={tmp_path}", cwd=REPOSITORY,
    )  # fmt: skip
    run_dir = tmp_path / f"slurm-{job}"
    wait_for_step(run_dir, 2)
    slurm.signal(job, "USR1")
    states = slurm.wait(job)
    log = (tmp_path / "log").read_text()
    assert states == ["COMPLETED"], log
    stops = [line for line in log.splitlines() if "stopped by" in line]
    assert len(stops) == 1
    assert stops[0].endswith(f"of 12: job {job} is requeued")
    assert f"Goes on from {run_dir}/checkpoints/" in "".join(log.splitlines()), log
    ended = torch.load(run_dir / "checkpoints" / "last.ckpt", weights_only=True)
    assert ended["global_step"] == 12
    assert len(ended["random_states"]) == 2
    assert differing(ended, train(tmp_path / "uninterrupted", data, *RUN, ranks=2)) == []

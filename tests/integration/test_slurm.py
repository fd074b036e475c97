"""Jobs of Slurm. All in one file, as there is one Slurm: processes of pytest-xdist share no fixtures.

Training on two nodes, told to stop, requeued, and in the end the weights of a run that never stopped; data sets made by
arrays of jobs.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from marks import requires_blender, requires_slurm
from slurm_cluster import free_ports
from small_data import make
from training_runs import SETTINGS, differing, train, wait_for_step

from rfpp.shards.manifest import Manifest
from rfpp.training.checkpoint_files import step_file

REPOSITORY = Path(__file__).resolve().parents[2]
RUN = (
    "steps=12",
    "trainer.val_check_interval=5",
    "datamodule.workers=1",
    "+callbacks.skewed._target_=faulty_callbacks.Skewed",
)


def submitted(slurm, folder: Path, *options: str, run: tuple[str, ...] = RUN) -> tuple[str, Path, Path]:
    """A job of two ranks on two nodes, the second behind the first; returns its number, its data, its run folder.

    Args:
        options: of sbatch, before those of launch/slurm/train.sbatch.
        run: what is trained.
    """
    data = Path(make(folder / "data" / "small", splits={"train": 7, "validation": 2}).root)
    environment = {"PYTHON": sys.executable, "PYTHONPATH": f"{REPOSITORY}:{REPOSITORY}/tests/support"}
    # Lightning's port follows from the job's number, which another Slurm on this machine may have given too
    environment |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": free_ports(1)[0]}
    job = slurm.submit(
        "--nodes=2", "--ntasks-per-node=1", "--cpus-per-task=1", "--gpus-per-node=0", f"--output={folder}/log",
        "--export=ALL,OMP_NUM_THREADS=1," + ",".join(f"{key}={value}" for key, value in environment.items()),
        *options, "launch/slurm/train.sbatch", *SETTINGS, *run, "trainer.strategy=ddp", f"data.root={data}",
        f"run_dir={folder}/${{oc.env:RFPP_RUN}}", f"logger.folder={folder}", cwd=REPOSITORY,
    )  # fmt: skip
    return job, data, folder / f"slurm-{job}"


@requires_slurm
def test_a_preempted_and_a_killed_job_are_requeued_and_resume(slurm, tmp_path):
    job, data, run_dir = submitted(slurm, tmp_path)
    wait_for_step(run_dir, 2)
    slurm.signal(job, "USR1")
    wait_for_step(run_dir, 7)
    slurm.tasks(job)[1].kill()
    states = slurm.wait(job)
    log = (tmp_path / "log").read_text()
    assert states == ["COMPLETED"], log
    stops = [line for line in log.splitlines() if "stopped by" in line]
    assert len(stops) == 1
    assert f"of 12: job {job} is requeued" in stops[0]
    assert "".join(log.splitlines()).count(f"Resumes  {run_dir}/checkpoints/") == 2, log
    ended = torch.load(run_dir / "checkpoints" / "last.ckpt", weights_only=True)
    assert ended["global_step"] == 12
    assert len(ended["random_states"]) == 2
    assert differing(ended, train(tmp_path / "uninterrupted", data, *RUN, ranks=2)) == []


@requires_slurm
def test_slurm_signals_before_the_time_limit(slurm, tmp_path):
    """Its clock has a resolution of half a minute: two minutes less one and a half, or less one."""
    run = ("steps=190", "trainer.val_check_interval=190", *RUN[2:])  # a minute at least
    job, _, run_dir = submitted(slurm, tmp_path, "--time=2", "--signal=SIGUSR1@60", run=run)
    slurm.wait_for(job, "PENDING")  # again: requeued
    subprocess.run(["scontrol", "update", f"JobId={job}", "TimeLimit=10"], check=True)
    assert slurm.wait(job) == ["COMPLETED"], (tmp_path / "log").read_text()
    log = (tmp_path / "log").read_text()
    [stopped] = [line for line in log.splitlines() if "stopped by SIGUSR1" in line]
    assert f"of 190: job {job} is requeued" in stopped  # what Slurm says of it may follow in the same line
    step = int(stopped.split("after step ")[1].split()[0])
    resumed = f"Resumes  {step_file(run_dir / 'checkpoints', step)}" in "".join(log.splitlines())
    assert resumed == (step > 0)  # on a busy machine the first step may not have ended
    assert torch.load(run_dir / "checkpoints" / "last.ckpt", weights_only=True)["global_step"] == 190


@requires_slurm
def test_a_cancelled_job_saves_and_exits(slurm, tmp_path):
    job, _, run_dir = submitted(slurm, tmp_path)
    wait_for_step(run_dir, 1)
    slurm.cancel(job)
    assert slurm.wait(job) == ["CANCELLED"]
    log = (tmp_path / "log").read_text()
    [stopped] = [line for line in log.splitlines() if "stopped by SIGTERM after step" in line]
    assert stopped.endswith(f"resume with the same command and run_dir={run_dir}")
    step = int(stopped.split("after step ")[1].split()[0])
    assert (run_dir / "checkpoints" / "last.ckpt").resolve() == step_file(run_dir / "checkpoints", step)


@pytest.mark.parametrize(("says", "requeued"), [("error: shard-3.tar: damaged", False), ("killed", True)])
def test_a_job_is_requeued_unless_a_rank_named_an_error(tmp_path, says, requeued):
    for name, program in {
        "srun": f"echo training; echo '{says}' >&2; exit 137",
        "scontrol": "echo scontrol $*",
    }.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{program}\n")
        (tmp_path / name).chmod(0o755)
    names = ("SLURM_JOB_ID", "SLURM_JOB_NUM_NODES", "SLURM_NTASKS_PER_NODE")
    environment = {**os.environ, **dict.fromkeys(names, "7"), "SLURM_SUBMIT_DIR": str(tmp_path)}
    environment["PATH"] = f"{tmp_path}:{environment['PATH']}"
    command = ["bash", REPOSITORY / "launch/slurm/train.sbatch"]
    job = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert job.returncode == (137 if requeued else 1)
    assert job.stdout == ("training\nscontrol requeue 7\n" if requeued else "training\n")
    assert job.stderr.splitlines() == ([says] if requeued else [says, f"not requeued: {says}"])


SMALL = (
    "experiment=quickstart", "reference=preview", "data.resolution=16", "reference.samples=1", "farm.workers=1",
    "data.scenes_per_shard=1", "data.splits={train: 2, train_newviews: 1, validation: 0, test: 0}", "slice.count=2",
)  # fmt: skip


def generate(*overrides: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "launch/generate.py", *overrides, *SMALL]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)


@requires_slurm
@requires_blender
def test_slices_of_a_job_array_are_merged(slurm, tmp_path):
    root = f"data.root={tmp_path}/data"
    job = slurm.submit(
        "--array=0-1", "--cpus-per-task=1", "--mem-per-cpu=0", f"--output={tmp_path}/%a.log",
        f"--export=ALL,PYTHON={sys.executable}", "launch/slurm/generate.sbatch", *SMALL, root, cwd=REPOSITORY,
    )  # fmt: skip
    states = slurm.wait(job)
    logs = {path.name: path.read_text() for path in tmp_path.glob("*.log")}
    assert set(states) == {"COMPLETED"}, logs
    assert "Slice 1 of 2 is finished" in logs["1.log"]
    assert "join them with action=merge" in generate(root, "action=status").stdout
    merged = generate(root, "action=merge")
    assert merged.returncode == 0, merged.stderr
    assert Manifest.load(tmp_path / "data").counts["scenes"] == 3
    verified = generate(root, "action=verify")
    assert verified.returncode == 0, verified.stderr


@requires_slurm
@requires_blender
def test_the_submitit_launcher_makes_slices(slurm, tmp_path):
    launcher = ("-m", "hydra/launcher=slurm_array", "hydra.launcher.cpus_per_task=1", "hydra.launcher.mem_gb=0")
    place = (f"data.root={tmp_path}/data", f"hydra.launcher.submitit_folder={tmp_path}/submitit/%j")
    made = generate(*launcher, *place, "slice.index=0,1", f"hydra.sweep.dir={tmp_path}/sweep")
    assert made.returncode == 0, made.stderr
    merged = generate(place[0], "action=merge")
    assert merged.returncode == 0, merged.stderr

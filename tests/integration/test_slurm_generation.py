"""Data sets made by arrays of Slurm jobs."""

import subprocess
import sys
from pathlib import Path

from marks import requires_blender, requires_slurm

from rfpp.shards.manifest import Manifest

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = (
    "experiment=quickstart", "data.resolution=16", "reference.samples=1", "farm.workers=1", "data.scenes_per_shard=1",
    "data.splits={train: 2, train_newviews: 1, validation: 0, test: 0}", "slice.count=2",
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

"""Training under Slurm, killed again and again, against the same training left alone: the weights must be the same.

python tests/support/endurance.py --steps 2000 --kills 6

Starts a Slurm of its own that plays two nodes, so it needs root and Slurm's packages. Each run has two ranks, one on
each node. Everything after `--` goes to launch/train.py, as overrides do. The tests do the same in a minute; this is
for hours.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from mlflow import MlflowClient
from slurm_cluster import UNDER_WAY, SlurmCluster
from training_runs import differing

REPOSITORY = Path(__file__).resolve().parents[2]


def main() -> int:
    """Returns the exit status: 1 where the runs differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--kills", type=int, default=6)
    parser.add_argument("--minutes", type=float, nargs=2, default=(4.0, 9.0), help="between two kills (random)")
    parser.add_argument("--seed", type=int, default=0, help="of moments and kinds of kills")
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    runs = REPOSITORY / "data" / "runs" / f"endurance-{time.strftime('%Y-%m-%d_%H-%M-%S')}"
    runs.mkdir(parents=True)
    cluster = SlurmCluster(Path(tempfile.mkdtemp(prefix="slurm-")), nodes=2)
    try:
        cluster.start()
        overrides = (f"steps={options.steps}", *options.overrides)
        jobs = {name: submit(cluster, runs / name, overrides) for name in ("killed", "uninterrupted")}
        began = time.time()
        kill_often(cluster, jobs["killed"], options.kills, options.minutes, random.Random(options.seed))
        for name, job in jobs.items():
            print(f"{name}: {cluster.wait(job, timeout=24 * 3600)} after {(time.time() - began) / 60:.1f} minutes")
    finally:
        cluster.stop()
    return compare(runs / "killed", runs / "uninterrupted")


def submit(cluster: SlurmCluster, run_dir: Path, overrides: tuple[str, ...]) -> str:
    """A job of two ranks on two nodes, a core each; returns its number."""
    environment = {"PYTHON": sys.executable, "OMP_NUM_THREADS": "1", "MASTER_ADDR": "127.0.0.1", "MAX_RESTARTS": "1000"}
    return cluster.submit(
        "--nodes=2", "--ntasks-per-node=1", "--cpus-per-task=1", "--gpus-per-node=0", f"--output={run_dir}.log",
        "--export=ALL," + ",".join(f"{key}={value}" for key, value in environment.items()),
        "launch/slurm/train.sbatch", "experiment=quickstart", "trainer.strategy=ddp", "callbacks=ema",
        "callbacks.checkpoints.every_n_steps=50", *overrides, f"run_dir={run_dir}", f"name={run_dir.parent.name}",
        f"logger.run_name={run_dir.name}", cwd=REPOSITORY,
    )  # fmt: skip


def kill_often(cluster: SlurmCluster, job: str, times: int, minutes: tuple[float, float], draw: random.Random) -> None:
    kinds: dict[str, Callable[[], None]] = {
        "SIGKILL to one rank": lambda: draw.choice(cluster.tasks(job)).kill(),
        "SIGKILL to both ranks": lambda: [rank.kill() for rank in cluster.tasks(job)],
        "SIGUSR1, as before the time limit": lambda: cluster.signal(job, "USR1"),
        "scontrol requeue": lambda: subprocess.run(["scontrol", "requeue", job], check=True),
    }
    order = draw.sample(list(kinds), len(kinds))
    for i in range(times):
        time.sleep(60 * draw.uniform(*minutes))
        while (states := cluster.states(job)) != ["RUNNING"] or len(cluster.tasks(job)) < 2:
            if not set(states) & UNDER_WAY:
                raise SystemExit(
                    f"job {job} is {states} after {i} of {times} kills: see its log, beside its run folder"
                )
            time.sleep(1)
        kinds[order[i % len(order)]]()
        print(f"{time.strftime('%H:%M:%S')} kill {i + 1}: {order[i % len(order)]}", flush=True)


def compare(killed: Path, uninterrupted: Path) -> int:
    """Print both runs' weights hashes, and what is not the same; returns 1 where anything is not."""
    checkpoints, histories = [], []
    for run in (killed, uninterrupted):
        checkpoints.append(torch.load(run / "checkpoints" / "last.ckpt", weights_only=True))
        histories.append(loss_history(checkpoints[-1]["rfpp"]))
        restarts = "".join(Path(f"{run}.log").read_text().splitlines()).count("Resumes  ")  # Slurm cuts lines
        print(f"{run.name}: step {checkpoints[-1]['global_step']}, {restarts} restarts, ", end="")
        print(f"weights {weights_hash(checkpoints[-1])}, MLflow has the loss of {len(histories[-1])} steps")
    different = differing(*checkpoints)
    print("different:", different or "nothing", "(weights, average, optimizer, schedule, random states)")
    print("MLflow:", "the same steps with the same losses" if histories[0] == histories[1] else "DIFFERENT losses")
    return int(bool(different) or histories[0] != histories[1])


def weights_hash(checkpoint: dict) -> str:
    """SHA-256 of every weight, by name."""
    digest = hashlib.sha256()
    for key in ("current_model_state", "state_dict"):
        for name, value in sorted(checkpoint[key].items()):
            digest.update(name.encode() + value.numpy(force=True).tobytes())
    return digest.hexdigest()


def loss_history(about: dict) -> list[tuple[int, float]]:
    """What MLflow holds of a run: step, training loss."""
    client = MlflowClient(about["mlflow_tracking_uri"])
    return [(m.step, m.value) for m in client.get_metric_history(about["mlflow_run_id"], "train/loss")]


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that Slurm is stopped
    sys.exit(main())

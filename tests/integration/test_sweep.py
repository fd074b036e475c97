"""A sweep from the command line: each point trains in a folder of its own, and MLflow has all under one run."""

import json
import os
import subprocess
import sys
from pathlib import Path

import torch
from mlflow import MlflowClient
from small_data import make
from training_runs import SETTINGS

ROOT = Path(__file__).parents[2]


def test_points_have_their_own_folders_and_one_parent(tmp_path):
    data = make(tmp_path / "data", splits={"train": 4, "validation": 2}).root
    environment = {name: value for name, value in os.environ.items() if name not in ("RFPP_RUN", "RFPP_SWEEP")}
    command = [
        sys.executable, "launch/train.py", "-m", *SETTINGS, f"data.root={data}", "steps=2", "optimizer.lr=1e-3,1e-4",
        "name=rate-${optimizer.lr}",
        f"run_dir={tmp_path}/${{oc.env:RFPP_RUN}}", f"logger.folder={tmp_path}", f"hydra.sweep.dir={tmp_path}/sweep",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    [sweep] = {path.parent.parent for path in tmp_path.glob("*/*/config.yaml")}
    rates = []
    for point in ("0", "1"):
        ended = torch.load(sweep / point / "checkpoints" / "last.ckpt", weights_only=True)
        assert ended["global_step"] == 2
        rates.append(ended["optimizer_states"][0]["param_groups"][0]["initial_lr"])
    assert rates == [1e-3, 1e-4]
    client = MlflowClient(f"sqlite:///{tmp_path}/mlflow.db")
    runs = client.search_runs([experiment.experiment_id for experiment in client.search_experiments()])
    [parent] = [run for run in runs if run.info.run_name.startswith("sweep ")]
    children = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert {json.loads(run.data.params["optimizer.lr"]) for run in children} == {1e-3, 1e-4}

"""Whole training runs in processes of their own, as launch/train.py makes them: to be killed, and to be compared."""

from __future__ import annotations

import multiprocessing
import os
import socket
import sys
import time
from collections.abc import Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

import torch
from networks import SMALLEST

from rfpp.commands import CONFIG_DIR
from rfpp.training.checkpoint_files import step_file, step_files

#: Processes come from one that has imported everything.
_PROCESSES = multiprocessing.get_context("forkserver")
_PROCESSES.set_forkserver_preload(["launch.train", "rfpp.training.datamodule", "torch._dynamo"])
SETTINGS = (
    "experiment=quickstart", "debug=cpu", *SMALLEST, "size.width=54", "data.resolution=8", "loss.lpips_weight=0.0",
    "datamodule.batching.scenes_per_step=4", "datamodule.batching.views_per_scene=1", "schedule.warmup_steps=2",
    "callbacks.checkpoints.every_n_steps=1",
)  # fmt: skip
#: What a checkpoint holds that later steps depend on.
STATE = ("state_dict", "optimizer_states", "lr_schedulers", "random_states", "current_model_state", "averaging_state")


def start(run_dir: Path, data: Path, *overrides: str, ranks: int = 1) -> list[BaseProcess]:
    """Start a training run of so many ranks; `run_dir`'s parent holds its tracking and the output of each rank."""
    everything = (
        *SETTINGS, f"data.root={data}", f"run_dir={run_dir}", *overrides,
        *(() if "logger=none" in overrides else (f"logger.folder={run_dir.parent}",)),
        *((f"trainer.devices={ranks}", "trainer.strategy=ddp") if ranks > 1 else ()),
    )  # fmt: skip
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    processes = []
    for rank in range(ranks):
        place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(ranks), "NODE_RANK": "0"}
        environment = {**place, "LOCAL_RANK": str(rank)} if ranks > 1 else {}
        log = run_dir.parent / f"{run_dir.name}-{rank}.log"
        processes.append(_PROCESSES.Process(target=_train, args=(everything, environment, log), daemon=False))
        processes[-1].start()
    return processes


def train(run_dir: Path, data: Path, *overrides: str, ranks: int = 1) -> dict:
    """Train to the end; returns the last checkpoint's content."""
    codes = finish(start(run_dir, data, *overrides, ranks=ranks))
    assert codes == [0] * ranks, output(run_dir)
    return torch.load(run_dir / "checkpoints" / "last.ckpt", weights_only=True)


def finish(processes: Sequence[BaseProcess]) -> list[int | None]:
    """Wait for the processes; returns their exit codes."""
    for process in processes:
        process.join(120)
        process.kill()
    return [process.exitcode for process in processes]


def wait_for_step(run_dir: Path, step: int) -> None:
    """Until the checkpoint after this step, or a later one, is there."""
    deadline = time.monotonic() + 300  # a job of Slurm may be requeued meanwhile, and imports everything again
    while not any(path >= step_file(run_dir / "checkpoints", step) for path in step_files(run_dir / "checkpoints")):
        assert time.monotonic() < deadline, output(run_dir)
        time.sleep(0.002)


def output(run_dir: Path) -> str:
    """Return the output of all ranks and attempts of a run."""
    return "\n".join(path.read_text() for path in sorted(run_dir.parent.glob(f"{run_dir.name}-*.log")))


def differences(a, b, where: str = "") -> list[str]:
    """Return the paths where two nested states differ in any bit."""
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        same = (
            a.dtype == b.dtype and a.shape == b.shape and a.numpy(force=True).tobytes() == b.numpy(force=True).tobytes()
        )
        return [] if same else [where]
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [d for key in a for d in differences(a[key], b[key], f"{where}/{key}")]
    if isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{where}/{i}")]
    return [] if a == b else [where]


def differing(a: dict, b: dict, keys: Sequence[str] = STATE) -> list[str]:
    """Parts of two checkpoints that are not the same."""
    return [d for key in keys for d in differences(a.get(key), b.get(key), key)]


def _train(overrides: Sequence[str], environment: dict[str, str], log: Path) -> None:
    """One rank, as the command would run it."""
    with open(log, "a") as out:
        os.dup2(out.fileno(), 1)
        os.dup2(out.fileno(), 2)
    os.environ.update(environment)
    os.environ.pop("SLURM_CONF", None)
    from lightning.pytorch.utilities import rank_zero_only

    from launch.train import main

    rank_zero_only.rank = int(environment.get("LOCAL_RANK", 0))
    torch.set_num_threads(1)
    sys.argv = [str(CONFIG_DIR.parent / "launch" / "train.py"), *overrides]
    main()

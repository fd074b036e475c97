"""No loader process outlives the training that started it."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

TRAINS = """
import multiprocessing, os, sys, time
from pathlib import Path
from torch.utils.data import Dataset
from rfpp.training.loader import SceneLoader
from rfpp.training.parentage import end_with_parent


class Slow(Dataset):
    def __len__(self):
        return 2

    def __getitem__(self, index):
        Path(sys.argv[1], f"{index}.started").write_text(str(os.getpid()))
        if sys.argv[2] == "killed" or index:
            time.sleep(600)
        return index


if __name__ == "__main__":
    loader = SceneLoader(Slow(), num_workers=2, multiprocessing_context="spawn", worker_init_fn=end_with_parent)
    next(batches := iter(loader))
    while not Path(sys.argv[1], "1.started").exists():
        time.sleep(0.1)
    raise RuntimeError("validation failed")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems leave it to PyTorch's own watch")
@pytest.mark.parametrize("how", ["killed", "failed"])
def test_loader_processes_end_when_training_is_killed_or_fails(how, tmp_path):
    script = tmp_path / "trains.py"
    script.write_text(TRAINS)
    training = subprocess.Popen([sys.executable, script, tmp_path, how], stderr=subprocess.DEVNULL)
    try:
        children = [int(wait_for(tmp_path / f"{index}.started")) for index in range(2)]
        assert how == "failed" or all(running(child) for child in children)
        if how == "failed":
            assert training.wait(timeout=120) == 1
    finally:
        training.kill()
        training.wait()
    until = time.monotonic() + 60
    while any(running(child) for child in children):
        assert time.monotonic() < until, "loader processes are still there"
        time.sleep(0.1)


def wait_for(file: Path) -> str:
    until = time.monotonic() + 120
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < until, "no loader process has begun"
        time.sleep(0.1)
    return file.read_text()


def running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"

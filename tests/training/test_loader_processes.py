"""Loader processes share what they import, and end with the training process that started them."""

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

TRAINING = """
import os, sys, time
from pathlib import Path
from torch.utils.data import Dataset
from rfpp.training.datamodule import loader_processes
from rfpp.training.loader import SceneLoader
from rfpp.training.signals import exit_with_parent


class Slow(Dataset):
    def __len__(self):
        return 2

    def __getitem__(self, index):
        Path(sys.argv[1], f"{index}.started").write_text(str(os.getpid()))
        if sys.argv[2] == "killed" or index:
            time.sleep(600)
        return index


if __name__ == "__main__":
    processes = loader_processes()
    loader = SceneLoader(Slow(), num_workers=2, multiprocessing_context=processes, worker_init_fn=exit_with_parent)
    next(batches := iter(loader))
    while not Path(sys.argv[1], "1.started").exists():
        time.sleep(0.1)
    raise RuntimeError("validation failed")
"""


@pytest.mark.parametrize("end", ["killed", "failed"])
def test_loader_processes_share_imports_and_end_when_training_is_killed_or_fails(end, tmp_path):
    script = tmp_path / "training.py"
    script.write_text(TRAINING)
    training = subprocess.Popen([sys.executable, script, tmp_path, end], stderr=subprocess.DEVNULL)
    try:
        loaders = [int(wait_for(tmp_path / f"{index}.started")) for index in range(2)]
        assert end == "failed" or all(is_running(loader) for loader in loaders)
        if end == "killed" and sys.platform != "darwin":
            [server] = {psutil.Process(loader).parent() for loader in loaders}
            assert server.parent().pid == training.pid
            assert any("libtorch" in mapped.path for mapped in server.memory_maps())  # has imported for both
        if end == "failed":
            assert training.wait(timeout=120) == 1
    finally:
        training.kill()
        training.wait()
    until = time.monotonic() + 60
    while any(is_running(loader) for loader in loaders):
        assert time.monotonic() < until, "loader processes are still running"
        time.sleep(0.1)


def wait_for(file: Path) -> str:
    until = time.monotonic() + 120
    while not (file.exists() and file.read_text()):
        assert time.monotonic() < until, "no loader process has started"
        time.sleep(0.1)
    return file.read_text()


def is_running(process: int) -> bool:
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False

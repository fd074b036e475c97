"""One process trains a run at a time."""

import os
import signal
import subprocess
import sys

import pytest

from rfpp.errors import UserError
from rfpp.training.run import locked

HOLDER = """
import sys, time
from pathlib import Path
from rfpp.training.run import locked
with locked(Path(sys.argv[1])):
    print("holds", flush=True)
    time.sleep(60)
"""


def test_a_second_process_is_refused_until_the_first_has_finished(tmp_path):
    run = tmp_path / "runs" / "a"
    refused = pytest.raises(UserError, match=r"runs/a: another process is training this run")
    with locked(run), refused, locked(run):
        pass
    with locked(run):
        pass


def test_a_killed_process_releases_the_lock(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "holds\n"
        with pytest.raises(UserError), locked(tmp_path):
            pass
    finally:
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        holder.stdout.close()
    with locked(tmp_path):
        pass

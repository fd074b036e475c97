"""One process trains a run at a time."""

import os
import signal
import subprocess
import sys

import pytest

from rfpp.errors import UserError
from rfpp.training.run_lock import only_writer_of

HOLDS = """
import sys, time
from pathlib import Path
from rfpp.training.run_lock import only_writer_of
with only_writer_of(Path(sys.argv[1])):
    print("holds", flush=True)
    time.sleep(60)
"""


def test_a_second_one_is_refused_and_a_later_one_is_not(tmp_path):
    run = tmp_path / "runs" / "a"
    refused = pytest.raises(UserError, match=r"runs/a: another process is training this run")
    with only_writer_of(run), refused, only_writer_of(run):
        pass
    with only_writer_of(run):
        pass


def test_a_killed_process_lets_go(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLDS, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "holds\n"
        with pytest.raises(UserError), only_writer_of(tmp_path):
            pass
    finally:
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        holder.stdout.close()
    with only_writer_of(tmp_path):
        pass

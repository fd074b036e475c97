"""A process that hangs ends and says where."""

import subprocess
import sys

HANGING = """
import time
from rfpp.training.callbacks.watchdog import Watchdog

def wait_for_another_rank():
    time.sleep(60)

watchdog = Watchdog(minutes=0.02)
for _ in range(3):
    watchdog.on_train_batch_start()
    time.sleep(0.6)
watchdog.{hook}()
print("alive", flush=True)
wait_for_another_rank() if "{hook}" == "on_train_batch_start" else time.sleep(2)
"""


def run(hook: str) -> subprocess.CompletedProcess:
    program = [sys.executable, "-c", HANGING.format(hook=hook)]
    return subprocess.run(program, capture_output=True, text=True, timeout=120, check=False)


def test_it_prints_where_a_step_hangs_and_exits():
    process = run("on_train_batch_start")
    assert (process.returncode, process.stdout) == (1, "alive\n")
    assert "Timeout" in process.stderr and "in wait_for_another_rank" in process.stderr


def test_it_ends_with_training():
    assert run("on_train_end").returncode == 0

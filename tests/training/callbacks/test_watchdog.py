"""A process that hangs ends and says where."""

import subprocess
import sys

HANGING = """
import time
from rfpp.training.callbacks.watchdog import Watchdog
def wait_for_another_rank():
    time.sleep(60)
watchdog = Watchdog(minutes=0.02)
watchdog.on_train_batch_start()
watchdog.on_train_end()
time.sleep(2)
for _ in range(3):
    watchdog.on_train_batch_start()
    time.sleep(0.6)
print("alive", flush=True)
wait_for_another_rank()
"""


def test_it_prints_where_a_step_hangs_and_exits():
    process = subprocess.run([sys.executable, "-c", HANGING], capture_output=True, text=True, timeout=120, check=False)
    assert (process.returncode, process.stdout) == (1, "alive\n")
    assert "Timeout" in process.stderr and "in wait_for_another_rank" in process.stderr

"""Settings and fixtures of the whole suite."""

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
import torch
from slurm_cluster import SlurmCluster

torch.set_num_threads(1)  # two threads on busy cores stall each other

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # started in the background of a script: processes that tests start are to hear Ctrl-C all the same
    signal.signal(signal.SIGINT, signal.default_int_handler)

#: Files and tests that `make test` leaves to `make test-all`.
_SLOW = Path(__file__).with_name("slow_tests.txt")
#: Seconds in which the process has to end after its last test.
_ENDS_WITHIN = 120


def pytest_ignore_collect(collection_path, config):
    """`-m cuda` imports no test without a GPU's mark: machines that have one often lack what other tests import."""
    if config.getoption("markexpr") == "cuda" and collection_path.suffix == ".py":
        return True if "@requires_gpu" not in collection_path.read_text(encoding="utf-8") else None
    return None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the tests in slow_tests.txt as `slow`."""
    slow = tuple(line for line in _SLOW.read_text(encoding="utf-8").splitlines() if line and line[0] != "#")
    for item in items:
        if item.nodeid.startswith(slow):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    """Print stacks and exit if threads or child processes keep the session from ending."""
    if hasattr(session.config, "workerinput"):
        return  # one of several processes waits for the others, and is ended with them

    def end() -> None:
        print(f"{_ENDS_WITHIN} s after the last test this process has not ended. It waits here:", file=sys.__stderr__)
        faulthandler.dump_traceback(sys.__stderr__)
        os._exit(exitstatus)

    waiting = threading.Timer(_ENDS_WITHIN, end)
    waiting.daemon = True
    waiting.start()
    if hasattr(signal, "alarm"):  # later still, when Python's threads no longer run, the system ends it
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(2 * _ENDS_WITHIN)


@pytest.fixture(scope="session")
def in_process():
    """`in_process(function, *args)` runs it in a process of its own, without type checks, where bpy may live."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as worker:
        yield lambda function, *args: worker.submit(function, *args).result(timeout=300)


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The manifest of a complete small data set. Do not write into its folder."""
    from small_data import make  # late: machines with a GPU often lack what it imports

    return make(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture(scope="session")
def slurm(tmp_path_factory):
    """A running Slurm that plays two nodes."""
    cluster = SlurmCluster(tmp_path_factory.mktemp("slurm"), nodes=2)
    try:
        cluster.start()
        yield cluster
    finally:
        cluster.stop()

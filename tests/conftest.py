"""Settings and fixtures of the whole suite."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest
import torch
from slurm_cluster import SlurmCluster

torch.set_num_threads(1)  # two threads on busy cores stall each other


@pytest.fixture(scope="session")
def in_process():
    """`in_process(function, *args)` runs it in a process of its own, without type checks, where bpy may live."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as worker:
        yield lambda function, *args: worker.submit(function, *args).result(timeout=300)


@pytest.fixture(scope="session")
def slurm(tmp_path_factory):
    """A running Slurm that plays two nodes."""
    cluster = SlurmCluster(tmp_path_factory.mktemp("slurm"), nodes=2)
    try:
        cluster.start()
        yield cluster
    finally:
        cluster.stop()

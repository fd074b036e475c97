"""Marks for tests that need more than the core install; the summary of a run says what was skipped and why."""

from importlib.util import find_spec

import pytest
import slurm_cluster
import torch

requires_blender = pytest.mark.skipif(find_spec("bpy") is None, reason='no Blender: pip install "rfpp[blender]"')
requires_slurm = pytest.mark.skipif(
    not slurm_cluster.is_available(),
    reason="no Slurm to start: as root, apt-get install slurmctld slurmd slurm-client munge",
)


def requires_gpu(test):
    """Chosen by `pytest -m cuda`."""
    return pytest.mark.cuda(pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")(test))
